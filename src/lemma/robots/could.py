"""Upper bound of an arm's reachable set, over all orientations of the gripper.

:mod:`lemma.robots.reach` is the inner bound: positions that a robot reaches with the
gripper pointing down, without collisions. This module is the outer bound: the distance
from the base beyond which no joint angles bring the gripper, at a given height. It
uses kinematics alone. Joint limits, the table and self-collision can only reduce the
reachable set, so the bound also holds for every action of the control level.

Upper arm and forearm move in a vertical plane, and so does the offset of the second
wrist joint (d5). That joint turns the gripper about an axis across the offset, and the
last joint turns it about its own axis. A point of the gripper is therefore farthest
when the two long links and the vector from the second wrist joint to the point are
collinear. The maximum is then taken over the two remaining angles.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGER_WIDTH_M,
    FINGERTIP_BEYOND_TCP_M,
    TCP_OFFSET_M,
)
from lemma.robots.ur.arms import ARMS

HELD_OFF_CENTER_M = 0.035
"""Largest distance of the centre of a held cube from the tool centre point [m]: at this
distance the pads, 12 mm to either side, just touch the edge of the cube."""

_ANGLES = 721
"""Samples of each of the two angles over a turn: steps of 0.5 deg, errors of 0.1 mm."""
_HIGHEST_M = 0.2
"""Largest height at which objects are handled [m]: a cube on a cube on a pad."""


@dataclass(frozen=True, slots=True)
class Could:
    """The outer bounds of an arm type's reachable set: radii around its base."""

    touch_m: float
    """Largest distance of any part of the gripper, open fingertips included [m]."""
    place_m: float
    """Largest distance of the centre of a cube that is put down [m]."""

    def radius_m(self, radius_m: float, support_m: float = 0.0) -> float:
        """Return the distance from the base beyond which an object is out of reach [m].

        Args:
            radius_m: Radius of a disc that covers the object.
            support_m: Largest distance between the centre of the object and that of
                another one that counts as placed on it.
        """
        return max(self.touch_m + radius_m, self.place_m + support_m)


@lru_cache
def could_of(arm_name: str) -> Could:
    """Return the outer bounds of an arm type's reach for objects on the table.

    Raises:
        UnknownNameError: No such arm.
    """
    side = math.hypot(0.5 * FINGER_OPENING_M + FINGER_THICKNESS_M, 0.5 * FINGER_WIDTH_M)
    tip = TCP_OFFSET_M + FINGERTIP_BEYOND_TCP_M
    # Reach is largest at the height of the shoulder.
    height = min(ARMS[arm_name].d1, _HIGHEST_M)
    return Could(
        touch_m=farthest_m(arm_name, height, tip, side),
        place_m=farthest_m(arm_name, height, TCP_OFFSET_M, 0.0) + HELD_OFF_CENTER_M,
    )


@lru_cache
def farthest_m(
    arm_name: str, height_m: float, beyond_flange_m: float, beside_m: float = 0.0
) -> float:
    """Return the largest distance of a point of the gripper from the base's axis [m].

    Args:
        arm_name: Arm type.
        height_m: Height of the point above the foot of the base.
        beyond_flange_m: Position of the point along the gripper's axis, from the
            flange.
        beside_m: Its distance from that axis.

    Returns:
        An upper bound over all joint angles; 0 if the arm cannot get that high.

    Raises:
        UnknownNameError: No such arm.
    """
    arm = ARMS[arm_name]
    angle = np.linspace(-math.pi, math.pi, _ANGLES)
    sin5, cos5 = np.sin(angle)[:, None], np.cos(angle)[:, None]
    sin6, cos6 = np.sin(angle)[None, :], np.cos(angle)[None, :]
    along = arm.d6 + beyond_flange_m
    # The vector from the second wrist joint to the point: two components in the arm's
    # plane, and one across it.
    first = arm.d5 + beside_m * cos6
    second = along * sin5 + beside_m * sin6 * cos5
    across = arm.d4 + along * cos5 - beside_m * sin6 * sin5
    radius = arm.a2 + arm.a3 + np.sqrt(first * first + second * second)
    squared = radius * radius - (height_m - arm.d1) ** 2
    # Between two angles of the grid the maximum is slightly higher: round up.
    reach = np.sqrt(np.maximum(0.0, squared) + across * across)
    return math.ceil(float(reach[squared >= 0.0].max(initial=0.0)) * 1e3) / 1e3
