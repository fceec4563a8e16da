"""Poses of a hand that may lean: matrices (4, 4), world from tool centre point."""

import math

import numpy as np

from lemma.core.poses import FloatArray, Pose2

LEANS_RAD = tuple(math.radians(d) for d in range(0, 80, 5))
"""Angles between the fingers and straight down, smallest first."""


def leaning(spot: Pose2, z: float, lean: float = 0.0) -> FloatArray:
    """Return the pose of a hand whose fingers point down and ahead.

    Args:
        spot: Position of the tool centre point. Its yaw is the direction in which the
            fingers point, seen from above; they close across it.
        z: Height of the tool centre point [m].
        lean: Angle from the vertical [rad]; at 0 the fingers point straight down.
    """
    c, s = math.cos(spot.yaw), math.sin(spot.yaw)
    down, ahead = math.cos(lean), math.sin(lean)
    pose = np.eye(4)
    pose[:3, 0] = (down * c, down * s, ahead)
    pose[:3, 1] = (s, -c, 0.0)
    pose[:3, 2] = (ahead * c, ahead * s, -down)
    pose[:3, 3] = (spot.x, spot.y, z)
    return pose


def drawn_back(hand: FloatArray, distance_m: float) -> FloatArray:
    """Return a hand moved back along the direction of its fingers."""
    pose = hand.copy()
    pose[:3, 3] -= distance_m * hand[:3, 2]
    return pose


def moved(
    hand: FloatArray, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0
) -> FloatArray:
    """Return a hand at another position [m], with the same orientation."""
    pose = hand.copy()
    pose[:3, 3] += (dx, dy, dz)
    return pose


def ahead(hand: FloatArray, distance_m: float, heading: float) -> FloatArray:
    """Return a hand moved along a horizontal direction."""
    return moved(hand, distance_m * math.cos(heading), distance_m * math.sin(heading))
