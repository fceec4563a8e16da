"""Obstacles of an arm: the other arms, and the objects on the table."""

import math

import numpy as np

from lemma.core.poses import FloatArray, Pose2
from lemma.motion.arm_motion import ArmMotion
from lemma.scene.objects.entity import kind_of
from lemma.scene.scene import Scene

_ARM_RANGE_M = 0.15
_OBJECT_RANGE_M = 0.05
_WORK_AREA_M = 0.16
"""Nearer to the target than this the gripper comes straight from above, between the
objects that stand there; pushing it sideways would make it miss."""


def around(
    arms: dict[str, ArmMotion],
    arm: ArmMotion,
    target: Pose2 | None,
    held: str | None,
) -> FloatArray:
    """Return the obstacles of one arm.

    Args:
        arms: All arms of the scene.
        arm: The arm that will move; it is no obstacle to itself.
        target: Where it will work, if anywhere; the object there is left out.
        held: The object that it holds or will pick up; left out.

    Returns:
        Capsules with the range in which they are felt, (n, 8) [m].
    """
    rows = [np.zeros((0, 8))]
    for other in arms.values():
        if other is not arm:
            capsules = other.capsules()
            rows.append(np.c_[capsules, np.full(len(capsules), _ARM_RANGE_M)])
    near = [
        capsule
        for name in arm.scene.spec.object_names
        if name != held
        for capsule in _object_capsules(arm.scene, name)
        if target is None or _gap(capsule, target) > _WORK_AREA_M
    ]
    if near:
        rows.append(np.array(near))
    return np.concatenate(rows)


def _object_capsules(scene: Scene, name: str) -> list[list[float]]:
    """Return capsules, each (8,), that stand for an object, upright as it stood."""
    pose, z = scene.pose2(name), scene.pose(name).position[2]
    found = []
    for capsule in kind_of(name).obstacle:
        ends = []
        for x, y, up in (capsule.start, capsule.end):
            end = pose @ Pose2(x, y)
            ends += [end.x, end.y, z + up]
        found.append([*ends, capsule.radius_m, _OBJECT_RANGE_M])
    return found


def _gap(capsule: list[float], target: Pose2) -> float:
    """Return the horizontal distance between a capsule's axis and a pose [m]."""
    ax, ay, _, bx, by, _, _, _ = capsule
    dx, dy = bx - ax, by - ay
    length = dx * dx + dy * dy
    t = 0.0
    if length > 0.0:
        t = min(1.0, max(0.0, ((target.x - ax) * dx + (target.y - ay) * dy) / length))
    return math.hypot(target.x - ax - t * dx, target.y - ay - t * dy)
