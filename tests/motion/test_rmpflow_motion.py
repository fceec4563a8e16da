"""The motion that comes out of RMPflow: it arrives, and keeps what it must."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rmpflow_scenes import (
    ARM_NAMES,
    SUBSTEP_S,
    arm_model,
    errors,
    links,
    move,
    nearest_posture,
    pose_goal,
    posture_goal,
    ready,
    sphere_gaps,
    state_at,
    tcp,
)

from lemma.core.poses import FloatArray
from lemma.motion.rmpflow.leaves import Leaves
from lemma.motion.rmpflow.workspace import ArmModel
from lemma.robots.collision_model import envelope_of
from lemma.robots.reach import reach_of
from lemma.robots.ur.kinematics import top_down


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_reaches_a_pose(arm: str) -> None:
    model, far = arm_model(arm), 0.7 * reach_of(arm).travel_m
    q = ready(arm, far, -0.4, 0.3)
    pose = top_down(0.6 * far, 0.5 * far, 0.02, 1.2)
    goal = pose_goal(pose, nearest_posture(arm, pose, q))
    history = move(model, state_at(q), goal, 4.0)
    distance, angle = errors(tcp(model, history[-1, 0]), pose)
    assert distance < 1e-5
    assert angle < 1e-4
    assert np.abs(history[-1, 1]).max() < 1e-3
    # A second after the arm came within 2 mm it is still there.
    arrived = [errors(tcp(model, q), pose)[0] < 0.002 for q in history[::20, 0]]
    assert all(arrived[arrived.index(True) :])


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_follows_a_posture_when_there_is_no_target(arm: str) -> None:
    model, q = arm_model(arm), ready(arm, 0.5, 0.0, 0.3)
    posture = q + np.array([1.2, -0.3, 0.2, 0.3, -0.5, 0.8])
    history = move(model, state_at(q), posture_goal(posture, weight=20.0), 5.0)
    assert history[-1, 0] == pytest.approx(posture, abs=0.005)


@given(
    arm=st.sampled_from(ARM_NAMES),
    start=st.tuples(st.floats(0.5, 0.85), st.floats(-3, 3), st.floats(0.1, 0.3)),
    turn=st.floats(-0.8, 0.8),
    radius=st.floats(0.0, 1.0),
    height=st.floats(0.02, 0.3),
    yaw=st.floats(-1.5, 1.5),
)
def test_reaches_whatever_is_in_front_of_it(
    arm: str,
    start: tuple[float, float, float],
    turn: float,
    radius: float,
    height: float,
    yaw: float,
) -> None:
    model, reach = arm_model(arm), reach_of(arm)
    bearing = start[1] + turn
    q = ready(arm, start[0] * reach.travel_m, start[1], start[2])
    r = reach.inner_m + 0.05 + radius * (reach.travel_m - reach.inner_m - 0.07)
    x, y = r * math.cos(bearing), r * math.sin(bearing)
    pose = top_down(x, y, height, start[1] + yaw)
    history = move(
        model, state_at(q), pose_goal(pose, nearest_posture(arm, pose, q)), 3.0
    )
    assert_valid(model, history)
    distance, angle = errors(tcp(model, history[-1, 0]), pose)
    assert distance < 0.002
    assert angle < 0.02


def assert_valid(model: ArmModel, history: FloatArray) -> None:
    """Check what holds of every motion: limits, and no NaN."""
    assert np.isfinite(history).all()
    assert (history[:, 0] >= model.lower).all()
    assert (history[:, 0] <= model.upper).all()
    assert (np.abs(history[:, 1]) <= 0.95 * model.velocity_limits + 1e-12).all()
    assert np.abs(np.diff(history[:, 0], axis=0)).max() < 3.2 * SUBSTEP_S


@settings(max_examples=30)
@given(
    arm=st.sampled_from(ARM_NAMES),
    seed=st.integers(0, 2**32 - 1),
    fast=st.booleans(),
    weight=st.sampled_from([0.0, 1.0]),
)
def test_stays_valid_whatever_is_asked(
    arm: str, seed: int, fast: bool, weight: float
) -> None:
    """Also from wild states, to targets out of reach, with obstacles in the arm."""
    rng, model = np.random.default_rng(seed), arm_model(arm)
    limits = model.upper
    state = state_at(
        rng.uniform(-limits, limits),
        rng.uniform(-1, 1, 6) * model.velocity_limits * (0.9 if fast else 0.0),
    )
    x, y, z = rng.uniform(-2, 2, 3)
    pose = top_down(x, y, z, rng.uniform(-7, 7))
    goal = pose_goal(pose, rng.uniform(-2 * limits, 2 * limits))
    goal = goal._replace(target_weight=weight)
    obstacles = np.concatenate(
        [
            rng.uniform(-1, 1, (5, 6)),
            rng.uniform(0.01, 0.1, (5, 1)),
            rng.uniform(0.01, 0.2, (5, 1)),
        ],
        axis=1,
    )
    assert_valid(model, move(model, state, goal, 1.0, obstacles=obstacles))


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("weight", [1.0, 20.0])
def test_stops_gently_at_a_joint_limit_when_the_target_lies_beyond(
    joint: int, weight: float
) -> None:
    q = ready("ur5", 0.5, 0.0, 0.3)
    model = arm_model("ur5")._replace(sphere_meets_table=np.zeros(12))
    upper = model.upper.copy()
    upper[joint] = q[joint] + 0.4
    model = model._replace(upper=upper)
    beyond = posture_goal(q + 1.5 * np.eye(6)[joint], weight)
    history = move(model, state_at(q), beyond, 4.0)
    reached, speed = history[:, 0, joint], history[:, 1, joint]
    assert reached.max() <= upper[joint]
    assert upper[joint] - 0.1 < reached[-1] < upper[joint]
    assert abs(speed[-1]) < 0.05
    # An arm cannot stop at once: the end is seen from far enough.
    assert np.abs(np.diff(speed)).max() < 4 * Leaves().max_acceleration * SUBSTEP_S


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_velocity_leaf_keeps_joints_below_their_limits(arm: str) -> None:
    """Without the clipping: the leaf alone holds a joint near its onset."""
    model, q = arm_model(arm), ready(arm, 0.5, 0.0, 0.3)
    posture = q + np.array([-3.0, 0.0, 0.0, 0.0, 0.0, 3.0])
    history = move(model, state_at(q), posture_goal(posture, weight=20.0), 2.0)
    fraction = np.abs(history[:, 1]) / model.velocity_limits
    assert 0.5 < fraction.max() < 0.95


@pytest.mark.parametrize("arm", ARM_NAMES)
@pytest.mark.parametrize(
    "obstacle",
    [
        pytest.param((0.0, 0.0, 0.0, 0.0, 0.0, 0.25, 0.03, 0.15), id="post"),
        pytest.param((0.05, 0.02, 0.0, 0.05, 0.02, 0.25, 0.03, 0.15), id="post beyond"),
        pytest.param((0.0, 0.0, 0.2, 0.0, 0.0, 0.2, 0.05, 0.15), id="ball"),
    ],
)
def test_goes_around_an_obstacle(arm: str, obstacle: tuple[float, ...]) -> None:
    model, radius = arm_model(arm), 0.62 * reach_of(arm).travel_m
    start, pose = top_down(radius, -0.3, 0.2, 0.0), top_down(radius, 0.3, 0.2, 0.0)
    q = nearest_posture(arm, start, ready(arm, radius, 0.0, 0.2))
    goal = pose_goal(pose, nearest_posture(arm, pose, q))
    obstacles = np.array([obstacle])
    obstacles[:, [0, 3]] += radius
    straight = move(model, state_at(q), goal, 4.0)
    around = move(model, state_at(q), goal, 4.0, obstacles=obstacles)
    assert min(sphere_gaps(arm, h, obstacles).min() for h in straight[::8, 0]) < -0.01
    assert min(sphere_gaps(arm, h, obstacles).min() for h in around[::8, 0]) > 0.005
    distance, angle = errors(tcp(model, around[-1, 0]), pose)
    assert distance < 0.002
    assert angle < 0.02


def test_stalls_in_front_of_a_wall_instead_of_touching_it() -> None:
    model = arm_model("ur5")
    start, pose = top_down(0.5, -0.3, 0.2, 0.0), top_down(0.5, 0.3, 0.2, 0.0)
    q = nearest_posture("ur5", start, ready("ur5", 0.5, 0.0, 0.2))
    wall = np.array([[0.5, 0, z, 0.5, 0, z + 0.1, 0.03, 0.15] for z in (0.0, 0.2, 0.4)])
    goal = pose_goal(pose, nearest_posture("ur5", pose, q))
    history = move(model, state_at(q), goal, 4.0, obstacles=wall)
    assert errors(tcp(model, history[-1, 0]), pose)[0] > 0.2
    assert min(sphere_gaps("ur5", h, wall).min() for h in history[::8, 0]) > 0.0
    assert np.abs(history[-1, 1]).max() < 0.05


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_stays_above_the_table(arm: str) -> None:
    """The posture leads the arm into the table; only the fingers may go down there."""
    envelope, model = envelope_of(arm), arm_model(arm)
    q = ready(arm, 0.6 * reach_of(arm).travel_m, 0.0, 0.3)
    through = q + np.eye(6)[1]

    def lowest(q: FloatArray) -> float:
        placed, heights = links(model, q), []
        for link, sphere, meets in zip(
            envelope.sphere_links,
            envelope.spheres,
            envelope.sphere_meets_table,
            strict=True,
        ):
            if meets:
                centre = placed[int(link)] @ [*sphere[:3], 1.0]
                heights.append(float(centre[2]) - sphere[3])
        return min(heights)

    assert lowest(through) < -0.05
    history = move(model, state_at(q), posture_goal(through), 4.0)
    assert min(lowest(h) for h in history[::8, 0]) > 0.0
