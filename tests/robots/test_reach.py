"""The ring of reach against inverse kinematics, which it stands for."""

import math

import numpy as np
import pytest
from hypothesis import strategies as st

from lemma.core.poses import FloatArray, Pose2
from lemma.robots.collision_model import (
    envelope_of,
    place_capsules,
    self_clearance,
    table_clearance,
)
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.reach import (
    GRASP_HEIGHT_M,
    TRAVEL_HEIGHT_M,
    Reach,
    can_hold,
    gripper_ik,
    reach_map,
    reach_of,
)
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.kinematics import frames, top_down

ARM_NAMES = ("ur5", "ur10")
YAWS = (-2.1, -math.pi / 2, 0.0, 0.7)
EDGE_M = 0.003

bases = st.builds(
    Pose2, st.floats(-1, 1), st.floats(-1, 1), st.floats(-math.pi, math.pi)
)


def world_from_base(base: Pose2) -> FloatArray:
    matrix = np.eye(4)
    cos, sin = math.cos(base.yaw), math.sin(base.yaw)
    matrix[:2, :2] = [[cos, -sin], [sin, cos]]
    matrix[:2, 3] = base.xy
    return matrix


def reaches(arm: str, base: FloatArray, x: float, y: float, z: float) -> set[bool]:
    """Whether inverse kinematics has a solution, for each of several yaws."""
    return {len(gripper_ik(arm, base, top_down(x, y, z, yaw))) > 0 for yaw in YAWS}


@pytest.mark.parametrize("arm", ARM_NAMES)
@pytest.mark.parametrize("base", [Pose2(0.0, 0.0), Pose2(-0.7, 0.15, 0.4)])
def test_ring_agrees_with_inverse_kinematics(arm: str, base: Pose2) -> None:
    reach, matrix = reach_of(arm), world_from_base(base)
    counts = {"inside": 0, "low": 0, "outside": 0}
    for x in np.arange(base.x - 1.4, base.x + 1.4, 0.05):
        for y in np.arange(base.y - 1.4, base.y + 1.4, 0.05):
            margin = reach.margin(base, x, y)
            hold_margin = reach.hold_margin(base, x, y)
            low = reaches(arm, matrix, x, y, GRASP_HEIGHT_M)
            if margin > EDGE_M:
                counts["inside"] += 1
                assert low == {True}
                assert reaches(arm, matrix, x, y, TRAVEL_HEIGHT_M) == {True}
            elif margin < -EDGE_M and hold_margin > EDGE_M:
                counts["low"] += 1
                assert low == {True}
                assert reaches(arm, matrix, x, y, TRAVEL_HEIGHT_M) == {False}
            elif math.hypot(x - base.x, y - base.y) > reach.grasp_m + EDGE_M:
                counts["outside"] += 1
                assert low == {False}
    assert min(counts.values()) > 50


@pytest.mark.parametrize(
    ("arm", "travel_m", "grasp_m"), [("ur5", 0.80, 0.90), ("ur10", 1.24, 1.30)]
)
def test_ring_has_the_expected_size(arm: str, travel_m: float, grasp_m: float) -> None:
    reach = reach_of(arm)
    assert reach.travel_m == pytest.approx(travel_m, abs=0.02)
    assert reach.grasp_m == pytest.approx(grasp_m, abs=0.02)
    assert 0.1 < reach.inner_m < 0.25


def test_what_is_held_low_is_held_in_a_wider_ring() -> None:
    reach = Reach(inner_m=0.2, travel_m=0.8, grasp_m=0.9)
    base = Pose2(1.0, 0.0, math.pi)
    expected = {
        0.15: (-0.05, -0.05),
        0.25: (0.05, 0.05),
        0.55: (0.25, 0.35),
        0.75: (0.05, 0.15),
        0.85: (-0.05, 0.05),
        0.95: (-0.15, -0.05),
    }
    for radius, (margin, hold_margin) in expected.items():
        assert reach.margin(base, 1.0 - radius, 0.0) == pytest.approx(margin)
        assert reach.hold_margin(base, 1.0, radius) == pytest.approx(hold_margin)


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_gripper_ik_is_at_the_pose_and_clear(arm: str) -> None:
    base = world_from_base(Pose2(0.6, -0.2, 2.5))
    envelope, rng = envelope_of(arm), np.random.default_rng(0)
    capsules = envelope.capsules
    placed = np.empty((len(capsules), 7))
    all_frames, found = np.empty((7, 4, 4)), 0
    for _ in range(100):
        radius, bearing, yaw = rng.uniform((0.3, -3, -3), (0.8, 3, 3))
        x, y = 0.6 + radius * math.cos(bearing), -0.2 + radius * math.sin(bearing)
        pose = top_down(x, y, rng.uniform(0.02, 0.4), yaw)
        for q in gripper_ik(arm, base, pose):
            found += 1
            frames(ARMS[arm].dh, base, q, all_frames)
            tcp = all_frames[6].copy()
            tcp[:3, 3] += TCP_OFFSET_M * tcp[:3, 2]
            assert np.abs(tcp - pose).max() < 1e-9
            assert (np.abs(q) <= ARMS[arm].joint_range).all()
            place_capsules(
                all_frames, envelope.capsule_links, envelope.capsules, placed
            )
            assert table_clearance(placed) >= 0.01
            assert self_clearance(placed) >= 0.01
    assert found > 200


def test_can_hold_takes_the_robots_place_into_account() -> None:
    base = Pose2(-0.5, 0.3, 1.0)
    assert can_hold("ur5", base, 0.0, 0.3, GRASP_HEIGHT_M)
    assert not can_hold("ur5", base, 0.5, 0.3, GRASP_HEIGHT_M)
    assert can_hold("ur10", base, 0.5, 0.3, GRASP_HEIGHT_M)
    assert not can_hold("ur5", base, 0.0, 0.3, 1.2)


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_reach_map_is_the_margin_at_every_pixel(arm: str) -> None:
    base = Pose2(-0.7, 0.1, 0.3)
    x, y = np.linspace(-1.66, 1.66, 416), np.linspace(-1.66, 1.66, 416)
    rendered = reach_map(arm, base, x, y)
    assert rendered.shape == (416, 416)
    reach = reach_of(arm)
    for row, column in ((0, 0), (208, 208), (264, 90), (208, 121), (415, 415)):
        expected = reach.margin(base, x[column], y[row])
        assert rendered[row, column] == pytest.approx(expected, abs=1e-12)
    assert 0.1 < (rendered > 0).mean() < 0.9
