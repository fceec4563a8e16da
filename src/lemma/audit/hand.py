"""Poses of a hand that may lean, and what can be done with them: pure geometry."""

import math
from collections.abc import Iterator

import numpy as np

from lemma.core.poses import FloatArray

LEANS_RAD = tuple(math.radians(d) for d in range(0, 80, 5))
"""How far a hand may lean from pointing down, smallest first."""


def leaning(x: float, y: float, z: float, way: float, lean: float) -> FloatArray:
    """Return the pose, (4, 4), of a hand whose fingers point down and ahead.

    Args:
        x: Position of the tool centre point [m].
        y: Position [m].
        z: Position [m].
        way: Where the fingers point, seen from above; they close across it [rad].
        lean: From the vertical [rad]; 0 points straight down.
    """
    c, s = math.cos(way), math.sin(way)
    down, ahead = math.cos(lean), math.sin(lean)
    pose = np.eye(4)
    pose[:3, 0] = (down * c, down * s, ahead)
    pose[:3, 1] = (s, -c, 0.0)
    pose[:3, 2] = (ahead * c, ahead * s, -down)
    pose[:3, 3] = (x, y, z)
    return pose


def turned(hand: FloatArray, axis: int, angle: float) -> FloatArray:
    """Return a hand turned about one of its own axes, 0 to 2, by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    pose = hand.copy()
    pose[:3, one] = c * hand[:3, one] + s * hand[:3, two]
    pose[:3, two] = c * hand[:3, two] - s * hand[:3, one]
    return pose


def dipping(
    hand: FloatArray, point: tuple[float, float, float], heading: float, angle: float
) -> FloatArray:
    """Return a hand turned about a point so that what it holds dips.

    Args:
        hand: The hand, (4, 4).
        point: What stays where it is [m].
        heading: Where what it holds points, seen from above [rad].
        angle: By how much that end goes down [rad].
    """
    c, s = math.cos(angle), math.sin(angle)
    x, y = math.cos(heading), math.sin(heading)
    ahead, aside = np.array([x, y, 0.0]), np.array([-y, x, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    rotation = (
        np.outer(c * ahead - s * up, ahead)
        + np.outer(aside, aside)
        + np.outer(c * up + s * ahead, up)
    )
    pose = hand.copy()
    pose[:3, :3] = rotation @ hand[:3, :3]
    pose[:3, 3] = rotation @ (hand[:3, 3] - point) + point
    return pose


def drawn_back(hand: FloatArray, distance_m: float) -> FloatArray:
    """Return a hand that is a distance back along where its fingers point."""
    pose = hand.copy()
    pose[:3, 3] -= distance_m * hand[:3, 2]
    return pose


def moved(
    hand: FloatArray, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0
) -> FloatArray:
    """Return a hand elsewhere, turned the same way."""
    pose = hand.copy()
    pose[:3, 3] += (dx, dy, dz)
    return pose


def faces(yaw: float, near: float) -> Iterator[float]:
    """Yield the directions across a cube's faces, those nearest to a direction first.

    Args:
        yaw: Of the cube [rad].
        near: The direction [rad].
    """
    turns = sorted(range(4), key=lambda k: -math.cos(yaw + 0.5 * math.pi * k - near))
    for k in turns[:3]:
        yield yaw + 0.5 * math.pi * k


def turned_near(
    joints: FloatArray, reference: FloatArray, limits: FloatArray
) -> FloatArray:
    """Return joint angles, (6,), with whole turns added to be near others."""
    turns = np.round((reference - joints) / math.tau)
    turned = joints + turns * math.tau
    return np.where(np.abs(turned) > limits, joints, turned)
