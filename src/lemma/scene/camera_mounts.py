"""Poses of the robots' cameras, derived from bases and reach."""

import math

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray, Pose, Pose2, matrix_from_quaternion
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.spec import RobotPlacement

CAMERA_FOVY_RAD = math.radians(56.0)
CAMERA_WIDTH_PX = 640
CAMERA_HEIGHT_PX = 480
REACH_EDGE_M = 0.05
"""Margin around a robot's reach in the view of its close camera [m]."""
_NEAREST = 0.49
"""Visible distance behind a robot's base, as a fraction of :attr:`.Could.touch_m`; no
object is farther behind."""
_HEIGHT = 1.72
"""Height of a robot's cameras, as a fraction of :attr:`.Could.touch_m`."""
_IMAGE_MARGIN = 0.94
"""Fraction of the half image within which an object's centre counts as visible."""


def camera_mount(robot: RobotPlacement) -> tuple[Pose, float]:
    """Return the pose of a robot's camera: above it, directed at its half of the table.

    The view includes all that the robot reaches, also with the stick. The height grows
    with the arm's reach.

    Args:
        robot: The robot.

    Returns:
        World from camera (x right, y down, z forward) [m] and the vertical field of
        view [rad].
    """
    reach = could_of(robot.arm).touch_m
    height = _HEIGHT * reach
    eye = robot.base @ Pose2(0.18 * reach, 0.0, 0.0)
    target = robot.base @ Pose2(0.34 * reach, 0.0, 0.0)
    forward = np.array([target.x - eye.x, target.y - eye.y, -height])
    forward /= np.sqrt((forward**2).sum())
    right = np.array([forward[1], -forward[0], 0.0])
    right /= np.sqrt((right**2).sum())
    matrix = np.eye(4)
    matrix[:3, 0] = right
    matrix[:3, 1] = np.cross(forward, right)
    matrix[:3, 2] = forward
    matrix[:3, 3] = [eye.x, eye.y, height]
    return Pose.from_matrix(matrix), CAMERA_FOVY_RAD


def reach_mount(robot: RobotPlacement) -> tuple[Pose, float]:
    """Return the pose of a robot's close camera, as high as :func:`camera_mount`.

    It looks straight down. Its view is the smallest square on the table that includes
    all positions of objects that the robot reaches, with a margin for their height.

    Args:
        robot: The robot.

    Returns:
        World from camera (x right, y down, z forward) [m] and the field of view of the
        shorter side of the image [rad].
    """
    touch = could_of(robot.arm).touch_m
    half = reach_of(robot.arm).travel_m + REACH_EDGE_M
    eye = robot.base @ Pose2(half - REACH_EDGE_M - _NEAREST * touch, 0.0)
    height = _HEIGHT * touch
    cos, sin = math.cos(robot.base.yaw), math.sin(robot.base.yaw)
    matrix = np.array(
        [
            [sin, -cos, 0.0, eye.x],
            [-cos, -sin, 0.0, eye.y],
            [0.0, 0.0, -1.0, height],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return Pose.from_matrix(matrix), 2.0 * math.atan(half / height)


class CameraFootprint:
    """The part of the table that a robot's camera sees."""

    def __init__(self, robot: RobotPlacement) -> None:
        """Use the camera of the given robot."""
        pose, fovy = camera_mount(robot)
        self._eye = pose.position
        self._rotation = matrix_from_quaternion(pose.quaternion)
        half = math.tan(fovy / 2) * _IMAGE_MARGIN
        self._half = (half * CAMERA_WIDTH_PX / CAMERA_HEIGHT_PX, half)

    def sees(self, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        """Return whether positions on the table are inside the image with a margin.

        Args:
            x: World x, (n,) [m].
            y: World y, (n,) [m].

        Returns:
            One flag per position, (n,).
        """
        offset = (x - self._eye[0], y - self._eye[1], -self._eye[2])
        right, down, forward = (
            float(a) * offset[0] + float(b) * offset[1] + float(c) * offset[2]
            for a, b, c in self._rotation.T
        )
        seen: NDArray[np.bool_] = np.asarray(forward) > 0.0
        seen &= np.abs(right) <= self._half[0] * forward
        seen &= np.abs(down) <= self._half[1] * forward
        return seen
