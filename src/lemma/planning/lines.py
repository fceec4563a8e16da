"""Lines from base to gripper, by which schedules know whose sectors overlap."""

import math

from lemma.core.poses import Pose2
from lemma.motion.sectors import MARGIN_M

APART_M = 2 * MARGIN_M
"""Smallest distance between the lines from base to gripper of two busy arms [m]."""

Line = tuple[Pose2, Pose2]
"""Base and gripper."""


def are_near(one: Line, another: Line) -> bool:
    """Return whether two lines from base to gripper are closer than :data:`APART_M`."""
    for line, other in ((one, another), (another, one)):
        if any(_distance_m(end, other) < APART_M for end in line):
            return True
    sides = [
        [_side(line, end) > 0.0 for end in other]
        for line, other in ((one, another), (another, one))
    ]
    return all(a != b for a, b in sides)


def _side(line: Line, point: Pose2) -> float:
    (a, b), (x, y) = (line[0].xy, line[1].xy), point.xy
    return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])


def _distance_m(point: Pose2, line: Line) -> float:
    (ax, ay), (bx, by), (x, y) = (pose.xy for pose in (*line, point))
    length = max((bx - ax) ** 2 + (by - ay) ** 2, 1e-9)
    t = min(1.0, max(0.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length))
    return math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay))
