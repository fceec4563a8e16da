"""The stick as ReachNet knows it: axes around which it lies, as its record says.

Another stick, of other lengths or with another bar, is a change of that record alone.
"""

import torch
from torch import Tensor

from lemma.core.poses import Pose2
from lemma.scene.objects.kind import Part
from lemma.scene.objects.stick import STICK_KIND

_GRASP = STICK_KIND.grasp
assert _GRASP is not None
GRASP_M = _GRASP.at.x
"""Where the stick is grasped, along its own x axis from its frame [m]."""
HALF_M = STICK_KIND.disc_m
"""From its axes to its sides [m]."""


def _axis(part: Part) -> tuple[float, float, float, float]:
    """Return the ends of the axis of a part that lies, seen from the gripper.

    It runs from face to face, so that what is kept clear of it is clear of the ends.
    """
    assert _GRASP is not None
    half = (0.0, 0.0)
    if part.shape == "box":
        x, y, _ = part.size_m
        half = (x, 0.0) if x > y else (0.0, y)
    middle = _GRASP.at.inverse() @ Pose2(*part.position_m[:2])
    low, high = (middle @ Pose2(side * half[0], side * half[1]) for side in (-1, 1))
    return low.x, low.y, high.x, high.y


AXES_M = tuple(map(_axis, STICK_KIND.parts))
"""Ends u, v, u, v of each part's axis, seen from the gripper that holds the stick
[m]."""
_BAR = max(AXES_M, key=lambda axis: axis[0] + axis[2])
BAR_M = (0.5 * (_BAR[0] + _BAR[2]), 0.5 * (_BAR[1] + _BAR[3]))
"""Middle of the part that is farthest out, with which things are moved [m]."""
FAR_END_M = max(0.0, *(max(u, v) for u, _, v, _ in AXES_M)) + GRASP_M
"""A point on the stick's x axis, as far out as it goes, seen from its frame: it shows
how the stick lies [m]."""


def stick_distance(grasp: Tensor, yaw: Tensor, points: Tensor) -> Tensor:
    """Return the distance of points from the axes of lying sticks [m], (...).

    Args:
        grasp: Where the stick is grasped, (..., 2) [m].
        yaw: Yaw of the stick, (...) [rad].
        points: (..., 2) [m].
    """
    x, y = (points - grasp).unbind(-1)
    u, v = x * yaw.cos() + y * yaw.sin(), y * yaw.cos() - x * yaw.sin()
    return swept_distance(u, v, torch.zeros_like(u), torch.zeros_like(u))


def swept_distance(u: Tensor, v: Tensor, back: Tensor, forth: Tensor) -> Tensor:
    """Return the distance of points from all that a stick's axes pass over [m].

    Axes that run along the stick or across it, as those of the benchmark's do, are
    followed exactly; of others, the rectangle around them.

    Args:
        u: Coordinate of the points, ahead of the gripper when the motion begins [m].
        v: To its left [m].
        back: How far the stick moves back, at most 0 [m].
        forth: How far it moves ahead, at least 0 [m].
    """
    found = []
    for first_u, first_v, last_u, last_v in AXES_M:
        low, high = sorted((first_u, last_u))
        along = beyond(u, low + back, high + forth)
        left, right = sorted((first_v, last_v))
        found.append(along.hypot((v - v.clamp(left, right)).abs()))
    return torch.stack(found).amin(0)


def beyond(x: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return the distance of numbers from an interval."""
    return torch.maximum(low - x, x - high).clamp(min=0.0)
