"""Where cameras and waiting arms stand, derived from the robots."""

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
"""How much more of the table than its reach a robot's close camera sees [m]."""
_NEAREST = 0.49
"""How far behind its base a robot's camera sees, as a share of what the robot could
touch. Objects lie nowhere else."""
_HEIGHT = 1.72
"""Height of a robot's cameras, as a share of what the robot could touch."""
_IMAGE_MARGIN = 0.94
"""Fraction of the half image in which an object's centre counts as seen."""


def camera_mount(robot: RobotPlacement) -> tuple[Pose, float]:
    """Return where a robot's camera hangs: above it, looking at its half of the table.

    The camera sees what the robot reaches, and what it touches with the stick in its
    hand. Its height grows with the arm's reach.

    Returns:
        World from camera (x right, y down, z forward) and the vertical field of view
        [rad].
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
    """Return where a robot's close camera hangs: as high as its other one.

    It looks straight down and is cropped to the smallest square on the table that holds
    all that the robot reaches where objects lie, with a margin for their height.

    Returns:
        World from camera (x right, y down, z forward) and the field of view of the
        shorter side of the picture [rad].
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
    """Part of the table that a robot's camera sees."""

    def __init__(self, robot: RobotPlacement) -> None:
        """Look from where the robot's camera hangs."""
        pose, fovy = camera_mount(robot)
        self._eye = pose.position
        self._rotation = matrix_from_quaternion(pose.quaternion)
        half = math.tan(fovy / 2) * _IMAGE_MARGIN
        self._half = (half * CAMERA_WIDTH_PX / CAMERA_HEIGHT_PX, half)

    def sees(self, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        """Return which positions on the table lie well inside the image.

        Args:
            x: World positions, (n,) [m].
            y: World positions, (n,) [m].
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
