"""RMPflow as a whole: its algebra, and the motion that comes out."""

import math

import numpy as np
import pytest
from rmpflow_scenes import (
    ARM_NAMES,
    SUBSTEP_S,
    acceleration,
    arm_model,
    links,
    move,
    nearest_posture,
    pose_goal,
    posture_goal,
    ready,
    state_at,
    tcp,
)

from lemma.core.poses import FloatArray
from lemma.motion.rmpflow import policy as rmpflow
from lemma.motion.rmpflow.leaves import Leaves
from lemma.motion.rmpflow.policy import integrate
from lemma.motion.rmpflow.workspace import ArmModel, ArmTarget, Workspace
from lemma.robots.ur.kinematics import top_down


def some_states(count: int, seed: int = 0) -> FloatArray:
    """Return joint angles and velocities, (count, 2, 6)."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [rng.uniform(-2.5, 2.5, (count, 6)), rng.uniform(-1, 1, (count, 6))], axis=1
    )


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_curvature_is_the_acceleration_at_constant_joint_speed(arm: str) -> None:
    model, step = arm_model(arm), 1e-4
    local = np.array([0.02, -0.05, 0.12, 1.0])
    for q, qd in some_states(30):
        root = Workspace()
        root.load(model, posture_goal(q), Leaves())
        rmpflow.update_motion(root.record[0], q, qd)
        before, now, after = (links(model, q + s * qd) for s in (-step, 0.0, step))
        for link in range(7):
            path = [(frames[link] @ local)[:3] for frames in (before, now, after)]
            expected = (path[0] - 2 * path[1] + path[2]) / step**2
            offset = path[1] - now[link, :3, 3]
            drift = rmpflow.point_drift(root.record[0], link, *offset)
            found = root.record["origin_acceleration"][0, link] + drift
            assert found == pytest.approx(expected, abs=1e-5)
            spin = root.record["omega"][0, link]
            turned = (after[link, :3, :3] - before[link, :3, :3]) / (2 * step)
            assert np.cross(spin, now[link, :3, 0]) == pytest.approx(
                turned[:, 0], abs=1e-6
            )


def test_solve_agrees_with_numpy() -> None:
    rng, out = np.random.default_rng(0), np.empty(6)
    for _ in range(100):
        factor, force = rng.normal(size=(6, 6)), rng.normal(size=6)
        metric = factor @ factor.T + 0.1 * np.eye(6)
        expected = np.linalg.solve(metric, force)
        # The upper triangle is never read.
        rmpflow.solve(np.tril(metric) + np.triu(np.full((6, 6), np.nan), 1), force, out)
        assert out == pytest.approx(expected, rel=1e-9, abs=1e-12)


def textbook_tool_acceleration(
    model: ArmModel, state: FloatArray, goal: ArmTarget, parameters: Leaves
) -> FloatArray:
    """Pull target, axes, posture and damping back with differenced kinematics."""
    (q, qd), step = state, 1e-4
    metric, force = np.zeros((6, 6)), np.zeros(6)

    def pull_back(task: int, weight: FloatArray, wanted: FloatArray) -> None:
        def value(at: FloatArray) -> FloatArray:
            column: FloatArray = tcp(model, at)[:3, task]
            return column

        jacobian = np.stack(
            [
                (value(q + step * e) - value(q - step * e)) / (2 * step)
                for e in np.eye(6)
            ],
            axis=1,
        )
        bend = value(q + step * qd) - 2 * value(q) + value(q - step * qd)
        wanted = wanted - bend / step**2
        metric.__iadd__(jacobian.T @ weight @ jacobian)
        force.__iadd__(jacobian.T @ weight @ wanted)

    pose = tcp(model, q)
    rates = (tcp(model, q + step * qd) - tcp(model, q - step * qd)) / (2 * step)
    target, axis = parameters.target, parameters.axis
    error = goal.position - pose[:3, 3]
    distance = float(np.linalg.norm(error))
    near = (1 - target.near_floor) * math.exp(
        -0.5 * (distance / target.near_sigma_m) ** 2
    )
    near += target.near_floor
    beta = math.exp(-0.5 * (distance / target.boost_sigma_m) ** 2)
    along = np.outer(error, error) / distance**2
    weight = (
        near * target.near_metric * np.eye(3) + (1 - near) * target.far_metric * along
    )
    pull_back(
        3,
        (beta * target.boost + 1 - beta) * weight,
        target.gain * error / (distance + target.epsilon_m)
        - target.damping * rates[:3, 3],
    )
    beta = math.exp(-0.5 * (distance / axis.boost_sigma_m) ** 2)
    for n in range(3):
        pull_back(
            n,
            (beta * axis.boost + 1 - beta) * axis.metric * np.eye(3),
            axis.gain * (goal.rotation[:, n] - pose[:3, n])
            - axis.damping * rates[:3, n],
        )
    posture, damping = parameters.posture, parameters.damping
    away: FloatArray = goal.posture - q
    cap = min(1.0, posture.cap_rad / float(np.linalg.norm(away)))
    pull: FloatArray = posture.gain * cap * away - posture.damping * qd
    metric += (posture.metric + posture.inertia) * np.eye(6)
    force += posture.metric * pull
    speed = float(np.linalg.norm(qd))
    metric += (damping.metric * speed + damping.inertia) * np.eye(6)
    force -= damping.metric * damping.damping * speed**2 * qd
    return np.asarray(np.linalg.solve(metric, force), dtype=np.float64)


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_acceleration_is_the_textbook_sum(arm: str) -> None:
    """Far from limits and obstacles, against differences instead of Jacobians."""
    model = arm_model(arm)._replace(sphere_meets_table=np.zeros(12))
    model = model._replace(lower=np.full(6, -1e6), upper=np.full(6, 1e6))
    parameters = Leaves(max_acceleration=1e9)
    rng = np.random.default_rng(1)
    for number, state in enumerate(some_states(20, seed=2)):
        x, y, z = rng.uniform(-0.6, 0.6, 3)
        if number % 2:
            # So near that metrics are round, and boosted.
            x, y, z = tcp(model, state[0])[:3, 3] + rng.uniform(-0.02, 0.02, 3)
        pose = top_down(x, y, z, rng.uniform(-3, 3))
        posture = state[0] + rng.uniform(-1, 1, 6) * (0.3 if number % 4 < 2 else 1.5)
        goal = pose_goal(pose, posture)
        out = acceleration(goal, parameters, state, model)
        expected = textbook_tool_acceleration(model, state, goal, parameters)
        scale = float(np.abs(expected).max())
        assert out == pytest.approx(expected, abs=1e-6 * scale)


def test_acceleration_is_capped_in_its_own_direction() -> None:
    obstacles = np.array([(0.3, 0.0, 0.3, 0.5, 0.0, 0.3, 0.05, 0.2)])
    largest = 0.0
    unbounded = Leaves(max_acceleration=1e9)
    for state in some_states(100, seed=3):
        goal = pose_goal(top_down(0.5, 0.1, 0.2, 1.0), state[0] + 1.0)
        free, capped = (
            acceleration(goal, leaves, state, obstacles=obstacles)
            for leaves in (unbounded, Leaves())
        )
        norm, limit = float(np.linalg.norm(free)), Leaves().max_acceleration
        largest = max(largest, norm)
        assert capped == pytest.approx(free * min(1.0, limit / norm), rel=1e-9)
    assert largest > Leaves().max_acceleration


def test_obstacle_pushes_harder_the_nearer_it_is() -> None:
    """A ball in front of an arm that otherwise wants to stay where it is."""
    model, q, step = arm_model("ur5"), ready("ur5", 0.5, 0.0, 0.3), 1e-6
    x, y, z = tcp(model, q)[:3, 3]

    def push(away_m: float) -> float:
        ball = np.array([[*(x + away_m, y, z) * 2, 0.03, 0.15]])
        leaves = Leaves(max_acceleration=1e9)
        out = acceleration(posture_goal(q), leaves, state_at(q), obstacles=ball)
        moved = tcp(model, q + step * out) - tcp(model, q)
        return -float(moved[0, 3]) / step

    free = push(1.0)
    assert push(0.25) == free  # farther than the ball is felt
    pushes = [push(away_m) - free for away_m in (0.14, 0.12, 0.10, 0.08)]
    assert pushes == sorted(pushes)
    assert pushes[0] > 0.01
    assert pushes[-1] > 1.0


def scenario() -> tuple[ArmModel, FloatArray, ArmTarget, FloatArray]:
    q = ready("ur5", 0.5, 0.0, 0.3)
    pose = top_down(0.4, 0.3, 0.1, 0.5)
    goal = pose_goal(pose, nearest_posture("ur5", pose, q))
    obstacles = np.array([[0.45, 0.1, 0, 0.45, 0.1, 0.2, 0.02, 0.1]])
    return arm_model("ur5"), state_at(q), goal, obstacles


def test_same_inputs_give_the_same_bits() -> None:
    runs = []
    for _ in range(2):
        model, state, goal, obstacles = scenario()
        runs.append(move(model, state, goal, 1.0, obstacles=obstacles))
    assert runs[0].tobytes() == runs[1].tobytes()


def test_result_does_not_depend_on_what_the_root_did_before() -> None:
    model, state, goal, obstacles = scenario()
    fresh, used = Workspace(), Workspace()
    for before in some_states(3, seed=4):
        other = pose_goal(top_down(0.3, -0.3, 0.2, 2.0), before[0])
        used.load(arm_model("ur10"), other, Leaves())
        integrate(used.record, used.spheres, before, obstacles, SUBSTEP_S, 5)
    states = []
    for root in (fresh, used):
        moved = state.copy()
        root.load(model, goal, Leaves())
        integrate(root.record, root.spheres, moved, obstacles, SUBSTEP_S, 50)
        states.append(moved.tobytes())
    assert states[0] == states[1]


def test_substeps_are_calls() -> None:
    model, state, goal, obstacles = scenario()
    root, at_once, one_by_one = Workspace(), state.copy(), state.copy()
    root.load(model, goal, Leaves())
    integrate(root.record, root.spheres, at_once, obstacles, SUBSTEP_S, 20)
    for _ in range(20):
        integrate(root.record, root.spheres, one_by_one, obstacles, SUBSTEP_S, 1)
    assert at_once.tobytes() == one_by_one.tobytes()


def test_root_notices_what_was_replaced() -> None:
    model, state, goal, _ = scenario()
    root = Workspace()

    def now(model: ArmModel, goal: ArmTarget, parameters: Leaves) -> FloatArray:
        return acceleration(goal, parameters, state, model, root=root)

    first = now(model, goal, Leaves())
    # A ball that the gripper holds comes near the table, which pushes it.
    held = model._replace(
        spheres=np.r_[model.spheres, [[0.0, 0.0, 0.2, 0.2]]],
        sphere_links=np.r_[model.sphere_links, 6.0],
        sphere_meets_table=np.r_[model.sphere_meets_table, 1.0],
    )
    turned = goal._replace(posture=goal.posture + 0.1)
    weak = Leaves(max_acceleration=1.0)
    for changed in ((held, goal), (model, turned)):
        assert not np.array_equal(now(*changed, Leaves()), first)
        assert np.array_equal(now(model, goal, Leaves()), first)
    assert not np.array_equal(now(model, goal, weak), first)
    assert np.array_equal(now(model, goal, Leaves()), first)
