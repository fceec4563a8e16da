"""Waypoints and poses that skills derive from a sub-task."""

import math
from dataclasses import replace

from lemma.core.poses import Pose2, wrap
from lemma.motion.arm_motion import ArmMotion
from lemma.motion.moves import Stand
from lemma.scene.spec import RobotPlacement
from lemma.tasks.drags import withdrawn
from lemma.tasks.subtask import GroundedSubTask, Primitive

_ASIDE_M = 0.03


def withdrawal(
    primitive: Primitive, robot: RobotPlacement, start: Stand, end: Stand
) -> list[Stand]:
    """Return waypoints that move the stick off the cube, so that fingers fit around it.

    A hook is pushed out beyond the cube and then moved aside; a head is drawn back.
    """
    poking = primitive is Primitive.POKE
    # The direction of the stick, from the gripper to the hook.
    sign = 1.0 if poking else -1.0
    bearing = math.atan2(sign * (end[1] - start[1]), sign * (end[0] - start[0]))
    left = withdrawn(primitive, robot, Pose2(end[0], end[1], bearing))
    back = (left.x, left.y, end[2], end[3])
    if poking:
        return [back]
    # The bar of the hook lies to the left of the handle: free it to the right.
    aside = left @ Pose2(0.0, -_ASIDE_M)
    return [back, (aside.x, aside.y, end[2], end[3])]


def as_it_turns(subtask: GroundedSubTask, arm: ArmMotion) -> GroundedSubTask:
    """Return the sub-task with pi added to both yaws, if that turns the arm less.

    The grasp is symmetric under half a turn. The object must still rotate from pick to
    place as in the sub-task, so either both yaws change or neither.
    """
    gripper = arm.tcp_pose()
    turned = math.pi + subtask.pick.yaw - math.atan2(gripper[1, 0], gripper[0, 0])
    if abs(wrap(turned)) >= 0.5 * math.pi:
        return subtask
    return replace(
        subtask,
        pick=replace(subtask.pick, yaw=subtask.pick.yaw + math.pi),
        place=replace(subtask.place, yaw=subtask.place.yaw + math.pi),
    )
