"""Where a robot could possibly touch or put anything, however it holds its hand.

:mod:`lemma.robots.reach` says where a robot surely *works*: hand pointing down, clear
of everything, with margin. This says the opposite: beyond which distance from its base
no posture of the joints brings the hand, at a given height. It is a bound by kinematics
alone: joint limits, the table and the arm itself can only take away from it, so it
holds for whatever the control level allows.

Upper arm and forearm move in a vertical plane, which also has the offset of the second
wrist joint (d5). That joint turns the hand about an axis across the offset, and the
last joint about the hand's own. A point of the hand is therefore farthest when the two
long links and the vector from the second wrist joint to the point are one line, and two
angles are left over which the maximum is taken.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lemma.core.poses import Pose2
from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGER_WIDTH_M,
    FINGERTIP_BEYOND_TCP_M,
    TCP_OFFSET_M,
)
from lemma.robots.ur.arms import ARMS

HELD_OFF_CENTER_M = 0.035
"""How far the middle of a held cube can be from the tool centre point: from there the
pads, 12 mm to either side, just touch its edge."""

_ANGLES = 721
"""Of each of the two angles over a turn: half a degree apart, which is 0.1 mm."""
_HIGHEST_M = 0.2
"""Objects on the table, also a cube on a cube on a pad, are handled below this."""


@dataclass(frozen=True, slots=True)
class Could:
    """The circle around its base beyond which an arm type can do nothing."""

    touch_m: float
    """No part of the hand gets farther, its open fingertips included."""
    place_m: float
    """No cube can be put farther, measured to its middle."""

    def excess(
        self, base: Pose2, x: float, y: float, radius_m: float, support_m: float = 0.0
    ) -> float:
        """Return how far out of a robot's possibilities a thing is [m].

        Args:
            base: Where the robot stands.
            x: Middle of the thing [m].
            y: Middle of the thing [m].
            radius_m: Of a disc around the thing.
            support_m: How far from the middle of the thing another may be put so that
                it counts as put upon it.

        Returns:
            The distance from the nearest point that the robot could touch, or on which
            it could put a cube; negative where it could.
        """
        r = math.hypot(x - base.x, y - base.y)
        return r - self.radius_m(radius_m, support_m)

    def radius_m(self, radius_m: float, support_m: float = 0.0) -> float:
        """Return the distance beyond which a thing is safe; see :meth:`excess`."""
        return max(self.touch_m + radius_m, self.place_m + support_m)


@lru_cache
def could_of(arm_name: str) -> Could:
    """Return what an arm type could do to things on the table at most.

    Raises:
        UnknownNameError: No such arm.
    """
    side = math.hypot(0.5 * FINGER_OPENING_M + FINGER_THICKNESS_M, 0.5 * FINGER_WIDTH_M)
    tip = TCP_OFFSET_M + FINGERTIP_BEYOND_TCP_M
    # At the height of the shoulder an arm reaches farthest.
    height = min(ARMS[arm_name].d1, _HIGHEST_M)
    return Could(
        touch_m=farthest_m(arm_name, height, tip, side),
        place_m=farthest_m(arm_name, height, TCP_OFFSET_M, 0.0) + HELD_OFF_CENTER_M,
    )


@lru_cache
def farthest_m(
    arm_name: str, height_m: float, beyond_flange_m: float, beside_m: float = 0.0
) -> float:
    """Return how far from the axis of its base a point of an arm's hand can get [m].

    Args:
        arm_name: Arm type.
        height_m: Height of the point above the foot of the base.
        beyond_flange_m: Where the point is along the hand's axis.
        beside_m: Its distance from that axis.

    Returns:
        An upper bound over all joint angles; 0 where the arm never gets that high.

    Raises:
        UnknownNameError: No such arm.
    """
    arm = ARMS[arm_name]
    angle = np.linspace(-math.pi, math.pi, _ANGLES)
    sin5, cos5 = np.sin(angle)[:, None], np.cos(angle)[:, None]
    sin6, cos6 = np.sin(angle)[None, :], np.cos(angle)[None, :]
    along = arm.d6 + beyond_flange_m
    # From the second wrist joint to the point: two directions of the arm's plane, and
    # the one across it.
    first = arm.d5 + beside_m * cos6
    second = along * sin5 + beside_m * sin6 * cos5
    across = arm.d4 + along * cos5 - beside_m * sin6 * sin5
    radius = arm.a2 + arm.a3 + np.sqrt(first * first + second * second)
    squared = radius * radius - (height_m - arm.d1) ** 2
    # Between two angles of the grid the maximum is a little higher: round up.
    reach = np.sqrt(np.maximum(0.0, squared) + across * across)
    return math.ceil(float(reach[squared >= 0.0].max(initial=0.0)) * 1e3) / 1e3
