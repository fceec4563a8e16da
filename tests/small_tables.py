"""Small scenes that several tests set: two arms face to face, and a few things."""

import math

from lemma.core.poses import Pose2
from lemma.robots.reach import reach_of
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec

ARM_NAMES = ("ur5", "ur10")


def facing(arm: str, *objects: ObjectPlacement, gap_m: float = -0.25) -> SceneSpec:
    """Return two arms of a type, red at the left and white at the right.

    Args:
        arm: Type of both arms.
        *objects: What lies on the table.
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


def cube(colour: str, x: float, y: float, yaw: float = 0.0) -> ObjectPlacement:
    """Return a cube."""
    return ObjectPlacement("cube", colour, Pose2(x, y, yaw))


def pad(colour: str, x: float, y: float) -> ObjectPlacement:
    """Return a pad."""
    return ObjectPlacement("pad", colour, Pose2(x, y))


def stick(pose: Pose2) -> ObjectPlacement:
    """Return the stick."""
    return ObjectPlacement("stick", "yellow", pose)
