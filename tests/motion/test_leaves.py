"""Each leaf of RMPflow on its own: what it wants and how much it cares."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rmpflow_scenes import (
    ELBOW_UP,
    ZEROS,
    acceleration,
    only,
    posture_goal,
    state_at,
)

from lemma.core.poses import FloatArray
from lemma.motion.rmpflow import leaves
from lemma.motion.rmpflow.leaves import (
    AxisLeaf,
    CollisionLeaf,
    JointLimitLeaf,
    TargetLeaf,
    VelocityCapLeaf,
)
from lemma.motion.rmpflow.workspace import ArmTarget


def evaluate_target(
    error: tuple[float, float, float], velocity: tuple[float, float, float] = ZEROS
) -> tuple[float, FloatArray, FloatArray]:
    acceleration, metric = np.empty(3), np.empty((3, 3))
    distance = leaves.target(
        TargetLeaf(), np.array(error), np.array(velocity), acceleration, metric
    )
    return distance, acceleration, metric


def test_target_pulls_along_the_error_and_fades_near_it() -> None:
    leaf = TargetLeaf()
    distance, far, _ = evaluate_target((0.3, -0.4, 0.0))
    assert distance == pytest.approx(0.5)
    assert np.cross(far, (0.3, -0.4, 0.0)) == pytest.approx(np.zeros(3))
    assert far[0] > 0 > far[1]
    # Far away the pull is nearly the gain, near the target nearly proportional.
    assert np.linalg.norm(far) == pytest.approx(leaf.gain * 0.5 / (0.5 + 0.075))
    _, near, _ = evaluate_target((0.001, 0.0, 0.0))
    _, nearer, _ = evaluate_target((0.0005, 0.0, 0.0))
    assert near[0] == pytest.approx(2 * nearer[0], rel=0.01)
    _, there, metric = evaluate_target(ZEROS)
    assert there.tolist() == [0.0, 0.0, 0.0]
    assert np.isfinite(metric).all()


def test_target_damps_velocity() -> None:
    velocity = (0.1, -0.2, 0.3)
    _, still, _ = evaluate_target((0.2, 0.0, 0.0))
    _, moving, _ = evaluate_target((0.2, 0.0, 0.0), velocity)
    assert moving - still == pytest.approx(-TargetLeaf().damping * np.array(velocity))


def test_target_metric_is_directional_far_away_and_round_near() -> None:
    leaf = TargetLeaf()
    _, _, far = evaluate_target((0.0, 1.0, 0.0))
    assert far[1, 1] == pytest.approx(leaf.far_metric, rel=0.05)
    assert far[0, 0] == pytest.approx(leaf.near_floor * leaf.near_metric)
    assert far[0, 0] < 0.1 * far[1, 1]
    assert np.abs(far - far.T).max() == 0.0
    _, _, near = evaluate_target((0.0, 1e-4, 0.0))
    expected = leaf.boost * leaf.near_metric * np.eye(3)
    assert np.abs(near - expected).max() < 1e-3 * leaf.boost * leaf.near_metric


def test_boost_grows_from_one_to_its_factor() -> None:
    distances = (0.5, 0.1, 0.05, 0.02, 0.01, 0.0)
    weights = [leaves.boost(20.0, 0.02, distance) for distance in distances]
    assert weights == sorted(weights)
    assert weights[0] == pytest.approx(1.0)
    assert weights[-1] == 20.0


def rotation_about(axis: FloatArray, angle: float) -> FloatArray:
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: FloatArray = np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k
    return turned


def evaluate_axes(
    rotation: FloatArray, goal: FloatArray, omega: FloatArray, distance: float = 1.0
) -> tuple[FloatArray, float]:
    wanted = np.empty(3)
    metric = leaves.axes(AxisLeaf(), rotation, goal, omega, distance, wanted)
    return wanted, metric


def test_axes_turn_the_short_way_and_rest_at_the_goal() -> None:
    axis = np.array([1.0, -2.0, 0.5])
    still = np.zeros(3)
    for angle in (-3.0, -1.0, 0.1, 2.0):
        wanted, _ = evaluate_axes(np.eye(3), rotation_about(axis, angle), still)
        expected = AxisLeaf().gain * math.sin(angle) * axis / np.linalg.norm(axis)
        assert wanted == pytest.approx(expected)
    goal = rotation_about(axis, 0.7)
    assert evaluate_axes(goal, goal, still)[0] == pytest.approx(np.zeros(3))


def test_axes_damp_and_weigh_more_at_the_target() -> None:
    leaf, omega = AxisLeaf(), np.array([0.3, -0.1, 0.2])
    wanted, far = evaluate_axes(np.eye(3), np.eye(3), omega)
    assert wanted == pytest.approx(-leaf.damping * omega)
    _, near = evaluate_axes(np.eye(3), np.eye(3), omega, distance=0.0)
    assert far == pytest.approx(2.0 * leaf.metric)
    assert near == pytest.approx(2.0 * leaf.metric * leaf.boost)


def test_axes_are_the_sum_of_three_leaves_pulled_back() -> None:
    """The textbook form: one leaf for each axis, with its own Jacobian."""
    rng, leaf = np.random.default_rng(0), AxisLeaf()
    for _ in range(20):
        now, goal = (rotation_about(rng.normal(size=3), rng.uniform()) for _ in "ab")
        omega, joints = rng.normal(size=3), rng.normal(size=(3, 6))
        metric, force = np.zeros((6, 6)), np.zeros(6)
        for n, m in zip(now.T, goal.T, strict=True):
            jacobian = np.cross(joints, n, axisa=0, axisc=0)
            wanted = leaf.gain * (m - n) - leaf.damping * np.cross(omega, n)
            metric += leaf.metric * jacobian.T @ jacobian
            force += leaf.metric * jacobian.T @ wanted
        together, weight = evaluate_axes(now, goal, omega)
        assert weight * joints.T @ joints == pytest.approx(metric)
        assert weight * joints.T @ together == pytest.approx(force)


@pytest.mark.slow
def test_posture_pulls_to_its_goal_and_is_capped() -> None:
    """The acceleration grows with the distance up to the cap, then keeps its size."""
    parameters = only("posture")
    weight = parameters.posture.metric
    mass = weight + parameters.posture.inertia
    found = {}
    for offset in (0.3, 1.0, 1.5, 3.0):
        goal = posture_goal(np.array(ELBOW_UP) + offset * np.eye(6)[0])
        out = acceleration(goal, parameters, state_at(ELBOW_UP))
        assert np.abs(out[1:]).max() == pytest.approx(0.0, abs=1e-12)
        found[offset] = out[0] * mass / weight
    gain = parameters.posture.gain
    assert found[0.3] == pytest.approx(gain * 0.3)
    assert found[1.0] == pytest.approx(gain * 1.0)
    assert found[1.5] == pytest.approx(gain * parameters.posture.cap_rad)
    assert found[3.0] == pytest.approx(gain * parameters.posture.cap_rad)


def test_posture_damps_velocity() -> None:
    parameters = only("posture")
    posture, qd = parameters.posture, np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.1])
    out = acceleration(
        posture_goal(np.array(ELBOW_UP)), parameters, state_at(ELBOW_UP, qd)
    )
    share = posture.metric / (posture.metric + posture.inertia)
    assert out == pytest.approx(-share * posture.damping * qd)


def test_joint_limit_pushes_away_and_matters_more_towards_the_limit() -> None:
    leaf = JointLimitLeaf()
    distances = (0.5, 0.2, 0.05, 0.01, 0.001, 0.0, -0.01)
    results = [leaves.joint_limit(leaf, x, 0.0) for x in distances]
    assert all(acceleration > 0 for acceleration, _ in results)
    assert [a for a, _ in results] == sorted(a for a, _ in results)
    assert [m for _, m in results] == sorted(m for _, m in results)
    assert results[-1] == results[-2]  # beyond the limit as at the limit
    assert results[0][1] < 1e-3 * results[-1][1]


def test_joint_limit_lets_go_of_a_joint_that_leaves() -> None:
    leaf = JointLimitLeaf()
    metrics = [leaves.joint_limit(leaf, 0.01, v)[1] for v in (-1.0, -0.01, 0.0, 0.01)]
    assert metrics == sorted(metrics, reverse=True)
    assert leaves.joint_limit(leaf, 0.01, 1.0)[1] < 1e-12
    # It brakes what approaches: the damping adds to the push.
    approaching = leaves.joint_limit(leaf, 0.01, -1.0)[0]
    resting = leaves.joint_limit(leaf, 0.01, 0.0)[0]
    assert approaching == pytest.approx(resting + leaf.damping)


def test_velocity_cap_is_silent_below_and_brakes_above() -> None:
    leaf, limit = VelocityCapLeaf(), 3.15
    onset = limit * leaf.limit_fraction - leaf.region_rad_s
    for speed in (0.0, 0.5 * onset, onset):
        assert leaves.velocity_cap(leaf, speed, limit) == (0.0, 0.0)
        assert leaves.velocity_cap(leaf, -speed, limit) == (0.0, 0.0)
    previous = 0.0
    for excess in (0.1, 0.3, 0.49, 0.6):
        brake, metric = leaves.velocity_cap(leaf, onset + excess, limit)
        assert brake == pytest.approx(-leaf.damping * excess)
        assert metric > previous
        assert np.isfinite(metric)
        assert leaves.velocity_cap(leaf, -onset - excess, limit) == (-brake, metric)
        previous = metric


def test_collision_is_silent_beyond_its_range() -> None:
    leaf = CollisionLeaf()
    for distance in (0.1, 0.11, 5.0):
        assert leaves.collision(leaf, distance, -1.0, 0.1) == (0.0, 0.0)


def test_collision_repels_and_fades_with_distance() -> None:
    leaf = CollisionLeaf()
    distances = (0.099, 0.05, 0.02, 0.005, 0.0, -0.02)
    results = [leaves.collision(leaf, x, 0.0, 0.1) for x in distances]
    assert all(acceleration > 0 for acceleration, _ in results)
    assert [a for a, _ in results] == sorted(a for a, _ in results)
    assert [m for _, m in results] == sorted(m for _, m in results)
    assert results[0][1] < 1e-6 * results[-1][1]  # no jump where the range begins
    assert results[-1] == results[-2]  # inside as at the surface


def test_collision_brakes_what_comes_and_ignores_what_goes() -> None:
    leaf = CollisionLeaf()
    resting, coming, going = (
        leaves.collision(leaf, 0.03, velocity, 0.1) for velocity in (0.0, -0.2, 0.2)
    )
    assert coming[0] > resting[0]
    assert coming[1] > resting[1] > going[1]
    assert going[1] < 1e-6 * coming[1]


@given(st.floats(-1e6, 1e6))
def test_sigmoid_is_the_logistic_function_without_overflow(x: float) -> None:
    value = leaves.sigmoid(x)
    assert 0.0 <= value <= 1.0
    assert value + leaves.sigmoid(-x) == pytest.approx(1.0)
    if abs(x) < 30:
        assert value == pytest.approx(1.0 / (1.0 + math.exp(-x)))


def test_damping_takes_energy_out_and_more_so_when_fast() -> None:
    parameters = only("damping")
    direction = np.array([0.5, -1.0, 0.7, 0.2, -0.3, 0.4])
    direction /= np.linalg.norm(direction)
    powers = []
    for speed in (0.1, 1.0, 2.0):
        goal = ArmTarget(np.zeros(3), np.eye(3), np.zeros(6), 0.0, 0.0)
        out = acceleration(goal, parameters, state_at(ELBOW_UP, speed * direction))
        powers.append(out @ direction)
        assert out == pytest.approx(powers[-1] * direction)
        mass = parameters.damping.metric * speed + parameters.damping.inertia
        expected = parameters.damping.metric * parameters.damping.damping * speed**3
        assert powers[-1] == pytest.approx(-expected / mass)
    assert powers == sorted(powers, reverse=True)
