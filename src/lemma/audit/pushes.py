"""Planar geometry of pushes with the stick.

Unlike :mod:`lemma.tasks.drags`, which the expert uses, it has all sides of the stick,
all grasps, and pushes of any length.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from lemma.core.poses import Pose2
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.stick import (
    GRASP_FROM_END_M,
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_SECTION_M,
)
from lemma.tasks.drags import Disc, stick_gap

LONGEST_M = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M)
"""Distance from the end of the handle to the tip of the hook [m]."""
# Gap between the stick and the object before a push.
_GAP_M = 0.02

_HALF_M = STICK_SECTION_M / 2
_CUBE_M = CUBE_EDGE_M / 2
# Position of the middle of the hook's bar along the handle.
_BAR_M = HANDLE_LENGTH_M - _HALF_M
_BESIDE_M = _HALF_M + _CUBE_M
_INSIDE_M = HANDLE_LENGTH_M - STICK_SECTION_M - _CUBE_M


@dataclass(frozen=True, slots=True)
class Contact:
    """A side of the stick and the direction in which it pushes."""

    at: tuple[float, float]
    """The middle of a cube that touches it, in the stick's frame [m]."""
    heading: float
    """Direction of the push, in the stick's frame [rad]."""


HOOK = Contact((_INSIDE_M, HOOK_LENGTH_M / 2), math.pi)
HEAD = Contact((HANDLE_LENGTH_M + _CUBE_M, HOOK_LENGTH_M / 2 - _HALF_M), 0.0)
CORNER = Contact((_INSIDE_M - 0.003, _BESIDE_M), math.pi / 2)
OUTSIDE = Contact((HANDLE_LENGTH_M - 0.08, -_BESIDE_M), -math.pi / 2)
TIP = Contact((_BAR_M, HOOK_LENGTH_M - _HALF_M + _CUBE_M), math.pi / 2)
CONTACTS = (HOOK, HEAD, CORNER, OUTSIDE, TIP)

END_GRASP = Pose2(GRASP_FROM_END_M, 0.0)
"""The expert's grasp, in the stick's frame: the stick then reaches farthest."""
HANDLE_GRASPS = tuple(
    Pose2(round(GRASP_FROM_END_M + 0.05 * i, 3), 0.0)
    for i in range(int((HANDLE_LENGTH_M - 0.12) / 0.05))
)
BAR_GRASPS = tuple(
    Pose2(_BAR_M, v, math.pi / 2) for v in (0.04, 0.08, HOOK_LENGTH_M - 0.035)
)
GRASPS = HANDLE_GRASPS + BAR_GRASPS
"""All grasps of the stick, as poses of the gripper in the stick's frame."""


@dataclass(frozen=True, slots=True)
class Push:
    """One push of an object with the stick; poses are in the world's frame."""

    grasp: Pose2
    """Gripper in the stick's frame."""
    stick: Pose2
    """Stick before the push."""
    start: Pose2
    """Gripper before the push."""
    end: Pose2
    """Gripper after the push."""
    moved: Pose2
    """Object after the push."""

    @property
    def length_m(self) -> float:
        """Length of the hand's path [m]."""
        return self.start.distance(self.end)


def push(
    contact: Contact, grasp: Pose2, thing: Pose2, heading: float, length_m: float
) -> Push:
    """Return the push of an object along a heading.

    Args:
        contact: Side of the stick that pushes.
        grasp: Gripper in the stick's frame.
        thing: Pose of the object, a cube or one of the same width.
        heading: Direction of the push [rad].
        length_m: Length of the push [m].
    """
    cos, sin = math.cos(heading), math.sin(heading)
    yaw = heading - contact.heading
    u, v = contact.at
    touching = Pose2(thing.x, thing.y, yaw) @ Pose2(-u, -v)
    stick = Pose2(touching.x - _GAP_M * cos, touching.y - _GAP_M * sin, touching.yaw)
    reached = Pose2(
        touching.x + length_m * cos, touching.y + length_m * sin, touching.yaw
    )
    moved = Pose2(thing.x + length_m * cos, thing.y + length_m * sin, heading)
    return Push(grasp, stick, stick @ grasp, reached @ grasp, moved)


def overlap_m(wanted: Push, obstacles: Sequence[Disc]) -> float:
    """Return the sum of the penetrations of stick and object into obstacles [m]."""
    deep = 0.0
    for part in (0.0, 0.5, 1.0):
        x = wanted.start.x + part * (wanted.end.x - wanted.start.x)
        y = wanted.start.y + part * (wanted.end.y - wanted.start.y)
        stick = Pose2(x, y, wanted.start.yaw) @ wanted.grasp.inverse()
        for ox, oy, radius in obstacles:
            deep += max(0.0, radius + _HALF_M - stick_gap(stick, ox, oy))
    for ox, oy, radius in obstacles:
        gap = math.hypot(ox - wanted.moved.x, oy - wanted.moved.y)
        deep += max(0.0, radius + _BESIDE_M - gap)
    return deep
