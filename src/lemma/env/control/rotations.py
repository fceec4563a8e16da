"""Conversions between quaternions, axis-angle vectors and six-number rotations.

An axis-angle vector points along the axis, and its length is the angle [rad]. Six
numbers (*rot6d*; Zhou et al., "On the Continuity of Rotation Representations in Neural
Networks", 2019) are the first column of the rotation matrix, then the second; any two
vectors that are not parallel give a rotation by Gram-Schmidt orthogonalization.

Scalars go through :mod:`math`, as in :mod:`lemma.core.poses`.
"""

import math
from collections.abc import Sequence

from lemma.core.poses import FloatArray, matrix_from_quaternion, quaternion_from_matrix
from lemma.core.seeding import ordered_sum

Quaternion = tuple[float, float, float, float]

_SMALL_RAD = 1e-9
_LEAST_NORM = 1e-3


def quaternion_from_axis_angle(vector: Sequence[float]) -> Quaternion:
    """Return the unit quaternion ``wxyz`` of an axis-angle vector, (3,) [rad]."""
    x, y, z = vector
    angle = math.hypot(x, y, z)
    # sin(a / 2) / a, whose limit is 1 / 2.
    scale = math.sin(0.5 * angle) / angle if angle > _SMALL_RAD else 0.5
    return (math.cos(0.5 * angle), scale * x, scale * y, scale * z)


def axis_angle_from_quaternion(quaternion: Sequence[float]) -> tuple[float, ...]:
    """Return the axis-angle vector, (3,) [rad], of a unit quaternion ``wxyz``.

    Its length is in [0, pi].
    """
    w, *axis = quaternion
    if w < 0.0:
        w, axis = -w, [-v for v in axis]
    sine = math.hypot(*axis)
    angle = 2.0 * math.atan2(sine, w)
    scale = angle / sine if sine > _SMALL_RAD else 2.0
    return tuple(scale * v for v in axis)


def quaternion_from_rot6d(six: Sequence[float]) -> Quaternion | None:
    """Return the unit quaternion ``wxyz`` of six numbers.

    Returns:
        None if they mean no rotation: a column is shorter than 0.001, or the two are
        parallel.
    """
    a, b = six[:3], six[3:]
    length = math.hypot(*a)
    if length < _LEAST_NORM:
        return None
    first = [v / length for v in a]
    along = ordered_sum(u * v for u, v in zip(first, b, strict=True))
    across = [v - along * u for u, v in zip(first, b, strict=True)]
    width = math.hypot(*across)
    # Relative to the norm, so that the result depends on the directions alone.
    if width < _LEAST_NORM * max(1.0, math.hypot(*b)):
        return None
    (x1, y1, z1), (x2, y2, z2) = first, [v / width for v in across]
    third = (y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2)
    rows = [[x1, x2, third[0]], [y1, y2, third[1]], [z1, z2, third[2]]]
    return quaternion_from_matrix(rows)


def rot6d_from_quaternion(quaternion: Quaternion) -> tuple[float, ...]:
    """Return the six numbers of a unit quaternion ``wxyz``."""
    matrix: FloatArray = matrix_from_quaternion(quaternion)
    return tuple(float(v) for column in (0, 1) for v in matrix[:, column])


def compose(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return ``a_from_c`` for unit quaternions ``a_from_b`` and ``b_from_c``."""
    w, x, y, z = first
    s, i, j, k = second
    product = (
        w * s - x * i - y * j - z * k,
        w * i + x * s + y * k - z * j,
        w * j - x * k + y * s + z * i,
        w * k + x * j - y * i + z * s,
    )
    norm = math.hypot(*product)
    a, b, c, d = (v / norm for v in product)
    return (a, b, c, d)
