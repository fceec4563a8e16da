"""Leaves that the textbook sum of test_rmpflow.py lacks: limits, and collisions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.motion.rmpflow import leaves
from lemma.motion.rmpflow.leaves import (
    AxisLeaf,
    CollisionLeaf,
    JointLimitLeaf,
    TargetLeaf,
    VelocityCapLeaf,
)


def test_at_the_target_and_its_orientation_nothing_is_wanted() -> None:
    still, metric, wanted = np.zeros(3), np.empty((3, 3)), np.empty(3)
    assert leaves.target(TargetLeaf(), still, still, wanted, metric) == 0.0
    assert wanted.tolist() == [0.0, 0.0, 0.0]
    assert np.isfinite(metric).all()
    assert leaves.axes(AxisLeaf(), np.eye(3), np.eye(3), still, 0.0, wanted) > 0.0
    assert wanted.tolist() == [0.0, 0.0, 0.0]


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
