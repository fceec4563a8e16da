"""Where cameras and waiting arms stand, derived from the robots."""

import math

import numpy as np

from lemma.core.poses import Pose, Pose2, matrix_from_quaternion
from lemma.robots.reach import reach_of
from lemma.scene.spec import RobotPlacement

CAMERA_FOVY_RAD = math.radians(56.0)
CAMERA_WIDTH_PX = 640
CAMERA_HEIGHT_PX = 480
_IMAGE_MARGIN = 0.94
"""Fraction of the half image in which an object's centre counts as seen."""


def camera_mount(robot: RobotPlacement) -> tuple[Pose, float]:
    """Return where a robot's camera hangs: above it, looking at its half of the table.

    The camera sees the robot's own half and the shared region, not the far half. Its
    height grows with the arm's reach.

    Returns:
        World from camera (x right, y down, z forward) and the vertical field of view
        [rad].
    """
    reach = reach_of(robot.arm).travel_m
    height = 0.45 + 1.10 * reach
    eye = robot.base @ Pose2(0.05 * reach, 0.0, 0.0)
    target = robot.base @ Pose2(0.33 * reach, 0.0, 0.0)
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


def camera_sees(robot: RobotPlacement, x: float, y: float) -> bool:
    """Whether a position on the table lies well inside a robot's camera image."""
    pose, fovy = camera_mount(robot)
    rotation = matrix_from_quaternion(pose.quaternion)
    offset = (x - pose.position[0], y - pose.position[1], -pose.position[2])
    right, down, forward = (
        sum(float(rotation[i, j]) * offset[i] for i in range(3)) for j in range(3)
    )
    if forward <= 0.0:
        return False
    half = math.tan(fovy / 2) * _IMAGE_MARGIN
    aspect = CAMERA_WIDTH_PX / CAMERA_HEIGHT_PX
    return abs(down) <= half * forward and abs(right) <= half * aspect * forward
