"""Small scenes that several tests set: two arms face to face, and a few things."""

import math

import numpy as np
import pytest

from lemma.core.poses import Pose2
from lemma.env.simulation import Simulation
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import reach_of
from lemma.robots.ur.kinematics import top_down
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.subtask import GroundedSubTask, Primitive

ARM_NAMES = ("ur5", "ur10")


def facing(arm: str, *objects: ObjectPlacement, gap_m: float = -0.25) -> SceneSpec:
    """Return two arms of a type, red at the left and white at the right.

    Args:
        arm: Type of both arms.
        *objects: Objects on the table.
        gap_m: Distance between their reaches; less than zero for a shared region [m].
    """
    away = reach_of(arm).travel_m + 0.5 * gap_m
    return SceneSpec(
        (
            RobotPlacement(arm, "red", Pose2(-away, 0.0, 0.0)),
            RobotPlacement(arm, "white", Pose2(away, 0.0, math.pi)),
        ),
        objects,
    )


def cube(color: str, x: float, y: float, yaw: float = 0.0) -> ObjectPlacement:
    """Return a cube."""
    return ObjectPlacement("cube", color, Pose2(x, y, yaw))


def pad(color: str, x: float, y: float) -> ObjectPlacement:
    """Return a pad."""
    return ObjectPlacement("pad", color, Pose2(x, y))


def stick(pose: Pose2) -> ObjectPlacement:
    """Return the stick."""
    return ObjectPlacement("stick", "yellow", pose)


def move(pick: Pose2, place: Pose2, robot: str = "robot_0") -> GroundedSubTask:
    """Return a grounded move."""
    return GroundedSubTask(robot, Primitive.MOVE, pick, place)


def stretch(simulation: Simulation, at: tuple[float, float, float]) -> None:
    """Let the other robot stand in the way."""
    arm = simulation.arms["robot_1"]
    posture = arm.solve_posture(top_down(*at, 0.0))
    assert posture is not None
    simulation.scene.set_joints(arm.robot, posture, FINGER_OPENING_M)
    arm.sync()
    arm.follow_posture(posture)
    simulation.rest(0.2)


def assert_ready(simulation: Simulation, robot: str = "robot_0") -> None:
    """The world is valid: every arm parked, grippers open, nothing held or flying."""
    scene = simulation.scene
    assert simulation.held() == {}
    for arm in simulation.arms.values():
        assert np.abs(scene.data.qpos[arm.robot.qpos] - arm.park).max() < 0.06
        assert arm.opening_m == FINGER_OPENING_M
    opening = scene.opening_m(simulation.arms[robot].robot)
    assert opening == pytest.approx(FINGER_OPENING_M, abs=0.002)
    assert np.isfinite(scene.snapshot()).all()
    simulation.rest(0.3)
    for name in scene.movable_names:
        assert scene.speed(name) < 0.02
        assert scene.pose(name).position[2] > 0.01
