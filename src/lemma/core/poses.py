"""Poses in the plane and in space.

Scalar functions are those of :mod:`math`, not NumPy ufuncs: NumPy selects SIMD kernels
by CPU, whose results differ in the last bits. Inputs of the simulation must be equal on
all machines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lemma.core.seeding import ordered_sum

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Pose2:
    """A pose on the table, in SE(2), world frame."""

    x: float
    """Position along x [m]; in a pair, x points from the first robot to the second."""
    y: float
    """Position along y [m], to the left of x."""
    yaw: float = 0.0
    """Counter-clockwise rotation about the vertical [rad]."""

    @property
    def xy(self) -> tuple[float, float]:
        """Position [m]."""
        return (self.x, self.y)

    def __matmul__(self, other: "Pose2") -> "Pose2":
        """Compose: ``a_from_b @ b_from_c`` is ``a_from_c``."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + cos * other.x - sin * other.y,
            self.y + sin * other.x + cos * other.y,
            wrap(self.yaw + other.yaw),
        )

    def inverse(self) -> "Pose2":
        """Return ``b_from_a`` for ``a_from_b``."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            -cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.yaw
        )

    def matrix(self) -> FloatArray:
        """Return the homogeneous transform at z = 0, shape (4, 4) [m]."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return np.array(
            [
                [cos, -sin, 0.0, self.x],
                [sin, cos, 0.0, self.y],
                [0.0, 0.0, 1.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )

    def distance(self, other: "Pose2") -> float:
        """Return the distance between the two positions [m]."""
        return math.hypot(self.x - other.x, self.y - other.y)

    def rounded(self, decimals: int = 4) -> "Pose2":
        """Return the pose with rounded numbers; by default to 0.1 mm and 0.1 mrad."""
        return Pose2(
            round(self.x, decimals), round(self.y, decimals), round(self.yaw, decimals)
        )


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose in space, in SE(3)."""

    position: tuple[float, float, float]
    """Position [m]."""
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion, ``wxyz``."""

    @classmethod
    def from_matrix(cls, matrix: FloatArray) -> Self:
        """Create a pose from a homogeneous transform.

        Args:
            matrix: Homogeneous transform, shape (4, 4) [m].
        """
        x, y, z = (float(v) for v in matrix[:3, 3])
        return cls((x, y, z), quaternion_from_matrix(matrix[:3, :3]))

    def matrix(self) -> FloatArray:
        """Return the homogeneous transform, shape (4, 4) [m]."""
        result = np.eye(4)
        result[:3, :3] = matrix_from_quaternion(self.quaternion)
        result[:3, 3] = self.position
        return result


def wrap(angle: float) -> float:
    """Return the equivalent angle in [-pi, pi) [rad]."""
    wrapped = (angle + math.pi) % (2.0 * math.pi) - math.pi
    # Just below -pi, the remainder is rounded to 2 pi.
    return wrapped if wrapped < math.pi else -math.pi


def matrix_from_quaternion(
    quaternion: tuple[float, float, float, float] | FloatArray,
) -> FloatArray:
    """Return the rotation matrix, shape (3, 3), of a unit quaternion ``wxyz``."""
    w, x, y, z = (float(v) for v in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_matrix(
    rotation: FloatArray | Sequence[Sequence[float]],
) -> tuple[float, float, float, float]:
    """Return the unit quaternion ``wxyz`` (w >= 0) of a rotation matrix (3, 3)."""
    r = [[float(v) for v in row] for row in rotation]
    # Divide by the largest of the four components, which is never close to zero.
    squares = (
        1 + r[0][0] + r[1][1] + r[2][2],
        1 + r[0][0] - r[1][1] - r[2][2],
        1 - r[0][0] + r[1][1] - r[2][2],
        1 - r[0][0] - r[1][1] + r[2][2],
    )
    k = squares.index(max(squares))
    if k == 0:
        q = [squares[0], r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    elif k == 1:
        q = [r[2][1] - r[1][2], squares[1], r[0][1] + r[1][0], r[0][2] + r[2][0]]
    elif k == 2:
        q = [r[0][2] - r[2][0], r[0][1] + r[1][0], squares[2], r[1][2] + r[2][1]]
    else:
        q = [r[1][0] - r[0][1], r[0][2] + r[2][0], r[1][2] + r[2][1], squares[3]]
    norm = math.sqrt(ordered_sum(v * v for v in q))
    sign = -1.0 if q[0] < 0 else 1.0
    w, x, y, z = (sign * v / norm for v in q)
    return (w, x, y, z)
