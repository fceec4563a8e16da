"""Bounds of reach: no posture of any arm breaks them."""

import math

import numpy as np
import pytest

from lemma.robots.could import HELD_OFF_CENTER_M, could_of, farthest_m
from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGER_WIDTH_M,
    FINGERTIP_BEYOND_TCP_M,
    TCP_OFFSET_M,
)
from lemma.robots.reach import reach_of
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.kinematics import forward

CORNERS = [
    (
        side * 0.5 * FINGER_WIDTH_M,
        other * (0.5 * FINGER_OPENING_M + FINGER_THICKNESS_M),
        TCP_OFFSET_M + FINGERTIP_BEYOND_TCP_M,
    )
    for side in (-1, 1)
    for other in (-1, 1)
]


def stretched(arm: str, rng: np.random.Generator) -> np.ndarray:
    """Joint angles near those that reach farthest: elbow straight, the rest random."""
    q = rng.uniform(-math.pi, math.pi, 6)
    q[2] = rng.normal(0.0, 0.1)
    return q


@pytest.mark.parametrize("arm", ARMS)
def test_no_posture_gets_the_hand_beyond_the_bound(arm: str) -> None:
    rng = np.random.default_rng(0)
    could, farthest = could_of(arm), 0.0
    for draw in range(20_000):
        q = stretched(arm, rng) if draw % 2 else rng.uniform(-math.pi, math.pi, 6)
        flange = forward(ARMS[arm].dh, q)
        points = [flange @ (*corner, 1.0) for corner in CORNERS]
        points.append(flange @ (0.0, 0.0, TCP_OFFSET_M, 1.0))
        reached = [math.hypot(point[0], point[1]) for point in points]
        assert max(reached[:-1]) <= could.touch_m
        assert reached[-1] + HELD_OFF_CENTER_M <= could.place_m
        farthest = max(farthest, *reached)
    # The bound is no guess far away: random postures come near.
    assert farthest > could.touch_m - 0.03


@pytest.mark.parametrize("arm", ARMS)
def test_the_bound_is_reached(arm: str) -> None:
    """Climb from the best random posture: what is left is less than 3 mm."""
    rng = np.random.default_rng(1)
    dh, corner = ARMS[arm].dh, (*CORNERS[0], 1.0)

    def reached(q: np.ndarray) -> float:
        x, y = (forward(dh, q) @ corner)[:2]
        return math.hypot(x, y)

    q = max((stretched(arm, rng) for _ in range(3000)), key=reached)
    step = 0.2
    for _ in range(6000):
        tried = q + rng.normal(0.0, step, 6)
        if reached(tried) > reached(q):
            q = tried
        else:
            step = max(0.997 * step, 1e-4)
    assert could_of(arm).touch_m - 0.003 < reached(q) <= could_of(arm).touch_m


@pytest.mark.parametrize("arm", ARMS)
def test_it_exceeds_what_surely_works(arm: str) -> None:
    could, works = could_of(arm), reach_of(arm)
    assert works.travel_m < works.grasp_m < could.place_m - HELD_OFF_CENTER_M
    assert could.touch_m < works.grasp_m + 0.2


def test_higher_and_lower_than_the_shoulder_is_nearer() -> None:
    shoulder = ARMS["ur5"].d1
    at = [farthest_m("ur5", shoulder + dz, TCP_OFFSET_M) for dz in (-0.3, 0.0, 0.3)]
    assert at[0] < at[1] > at[2]
    assert farthest_m("ur5", 3.0, TCP_OFFSET_M) == 0.0


def test_radius_counts_the_size_of_a_thing_and_what_may_be_put_on_it() -> None:
    could = could_of("ur5")
    assert could.radius_m(0.05) == could.touch_m + 0.05
    assert could.radius_m(0.0, 0.1) == could.place_m + 0.1
