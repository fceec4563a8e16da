"""Proprioception: joints, gripper and tool centre point, in one compiled call.

These are all measurements in an observation except images. Environments compute them in
every step; separate NumPy calls would take longer than the physics of a step.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.robots.gripper import FINGER_OPENING_M, TCP_OFFSET_M
from lemma.robots.ur.kinematics import frames
from lemma.scene.scene import Scene

Float32Array = NDArray[np.float32]

_ROBOT = np.dtype(
    [
        ("dh", np.float64, 6),
        ("world_from_base", np.float64, (4, 4)),
        ("qpos", np.int64),
        ("dof", np.int64),
        ("fingers", np.int64, 2),
    ]
)


class Proprioception:
    """Measures some robots of one scene."""

    def __init__(
        self, scene: Scene, names: Sequence[str], low: Float32Array, high: Float32Array
    ) -> None:
        """Look up the addresses of the robots in the arrays of the simulation.

        Args:
            scene: The scene.
            names: Names of n robots.
            low: Smallest values of all measurements, (21 n,).
            high: Largest values of all measurements, (21 n,).

        Raises:
            UnknownNameError: The scene has no such robot.
        """
        self.scene = scene
        self._count = 7 * len(names)
        self._low, self._high = low, high
        self._robots = np.zeros(len(names), _ROBOT)
        for row, name in zip(self._robots, names, strict=True):
            robot = scene.robot(name)
            row["dh"], row["world_from_base"] = robot.arm.dh, robot.world_from_base
            row["qpos"], row["dof"] = robot.qpos.start, robot.dof.start
            row["fingers"] = robot.finger_qpos
        self._qpos: FloatArray = scene.data.qpos
        self._qvel: FloatArray = scene.data.qvel

    def measure(self) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Return the measurements of all robots, clipped to the bounds.

        Returns:
            Three arrays with seven values per robot, (7 n,): joint angles [rad] and
            opening [m], their rates [rad/s, m/s], and position [m] with quaternion of
            the tool centre point.
        """
        out = np.empty(3 * self._count, np.float32)
        _measure(self._robots, self._qpos, self._qvel, self._low, self._high, out)
        n = self._count
        return out[:n], out[n : 2 * n], out[2 * n :]


@kernel
def _measure(
    robots: np.ndarray,
    qpos: FloatArray,
    qvel: FloatArray,
    low: Float32Array,
    high: Float32Array,
    out: Float32Array,
) -> None:
    placed, quaternion = np.empty((7, 4, 4)), np.empty(4)
    n = 7 * robots.shape[0]
    for k in range(robots.shape[0]):
        robot = robots[k]
        q, start = qpos[robot.qpos : robot.qpos + 6], 7 * k
        frames(robot.dh, robot.world_from_base, q, placed)
        _turn(placed[6], quaternion)
        for i in range(6):
            out[start + i] = q[i]
            out[n + start + i] = qvel[robot.dof + i]
        width = qpos[robot.fingers[0]] + qpos[robot.fingers[1]]
        out[start + 6] = min(max(width, 0.0), FINGER_OPENING_M)
        out[n + start + 6] = qvel[robot.dof + 6] + qvel[robot.dof + 7]
        for i in range(3):
            tcp = placed[6, i, 3] + TCP_OFFSET_M * placed[6, i, 2]
            out[2 * n + start + i] = tcp
        for i in range(4):
            out[2 * n + start + 3 + i] = quaternion[i]
    for i in range(out.shape[0]):
        if out[i] < low[i]:
            out[i] = low[i]
        elif out[i] > high[i]:
            out[i] = high[i]


@kernel
def _turn(r: FloatArray, out: FloatArray) -> None:
    """Compute :func:`lemma.core.poses.quaternion_from_matrix` inside a kernel."""
    squares = (
        1 + r[0, 0] + r[1, 1] + r[2, 2],
        1 + r[0, 0] - r[1, 1] - r[2, 2],
        1 - r[0, 0] + r[1, 1] - r[2, 2],
        1 - r[0, 0] - r[1, 1] + r[2, 2],
    )
    largest = 0
    for k in range(4):
        if squares[k] > squares[largest]:
            largest = k
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    if largest == 0:
        out[0], out[1], out[2], out[3] = squares[0], x, y, z
    elif largest == 1:
        out[0], out[1], out[2], out[3] = x, squares[1], xy, xz
    elif largest == 2:
        out[0], out[1], out[2], out[3] = y, xy, squares[2], yz
    else:
        out[0], out[1], out[2], out[3] = z, xz, yz, squares[3]
    norm = 0.0
    for i in range(4):
        norm += out[i] * out[i]
    norm = math.sqrt(norm)
    sign = -1.0 if out[0] < 0 else 1.0
    for i in range(4):
        out[i] = sign * out[i] / norm
