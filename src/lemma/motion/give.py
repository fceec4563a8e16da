"""``give``: one robot hands a thing to another one in the air.

The giver grasps the thing near one end and holds it out; meanwhile the taker comes to
where the other end will be. The taker comes down and grasps that end, the giver opens
its hand and rises, and the taker puts the thing down. Each waits for the other before
and after the thing changes hands (:class:`.Joint`).
"""

import math
from typing import TYPE_CHECKING

from lemma.core.poses import Pose2, wrap
from lemma.motion.arm_motion import ArmMotion
from lemma.motion.joint import Joint, reserve_together
from lemma.motion.moves import FLY_BY_M, Motion, Moves, Stand
from lemma.motion.outcome import Outcome, SkillFailure
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.robots.ur.kinematics import top_down
from lemma.scene.objects.entity import kind_of
from lemma.tasks.subtask import GroundedSubTask

if TYPE_CHECKING:
    from lemma.motion.skills import SkillRunner

MEETING_HEIGHT_M = 0.25
"""Height of both hands as the thing changes hands [m]."""
_ABOVE_M = 0.12
"""The taker waits so far above, where the thing passes below its fingers."""
_RISE_M = 0.08
"""The giver rises so far after it has let go."""
_PRESS_M = 0.0005


def give(runner: "SkillRunner", arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
    """Hand an object to the partner in the air; or take it, and put it down.

    Raises:
        SkillFailure: There is no end to hold at the pick pose, or one of both failed.
    """
    joint = runner.joints.get(arm.robot.name)
    if joint is None:
        raise SkillFailure(
            Outcome.INVALID,
            f"{subtask.primitive} takes two robots and an object with two ends to "
            f"hold, but there is no such end at ({subtask.pick.x:.3f}, "
            f"{subtask.pick.y:.3f}).",
        )
    gives = arm.robot.name == joint.leader
    yield from joint.share((_hand_over if gives else _take)(runner, arm, joint))


def _hand_over(runner: "SkillRunner", arm: ArmMotion, joint: Joint) -> Motion:
    """Bring the thing, and let go once the partner holds it."""
    moves, scene, name = Moves(arm), arm.scene, arm.robot.name
    yield from reserve_together(runner, arm, joint)
    pick, met = _parts(arm, joint)
    low = _stand(pick, _bottom_m(runner, joint) + _grip_m(joint))
    over, held_out = _stand(pick, TRAVEL_HEIGHT_M), _stand(met, MEETING_HEIGHT_M)
    risen = _stand(met, MEETING_HEIGHT_M + _RISE_M)
    for stand in (low, over):
        moves.check_reach(stand, "pick")
    for stand in (held_out, risen):
        moves.check_reach(stand, "meeting")
    runner.feel(arm, pick, joint.thing)
    yield from moves.grasp(over, low)
    yield from moves.rise(low, over[2] - FLY_BY_M)
    moves.check_held()
    runner.feel(arm, met, joint.thing)
    yield from moves.to(held_out, fly_by=True)
    yield from moves.to(held_out)
    moves.check_held()
    yield from joint.meet(name, scene)
    yield from joint.meet(name, scene)
    arm.opening_m = FINGER_OPENING_M
    yield from moves.wait_for_fingers()
    yield from moves.rise(held_out, risen[2])
    yield from joint.meet(name, scene)


def _parts(arm: ArmMotion, joint: Joint) -> tuple[Pose2, Pose2]:
    """Return the giver's hand as it picks the thing up, and as it holds it out."""
    assert joint.meeting is not None
    at = joint.start.inverse() @ joint.subtasks[arm.robot.name].pick
    grip = _turned(arm, at, joint.start, joint.meeting)
    return joint.start @ grip, joint.meeting @ grip


def _turned(arm: ArmMotion, grip: Pose2, start: Pose2, end: Pose2) -> Pose2:
    """Return a grip, half a turn on where that keeps the last joint off its limits.

    The hand turns with the arm as far as the thing does not turn by itself.

    Args:
        arm: The arm.
        grip: The hand in the frame of the thing.
        start: Where the hand grasps the thing.
        end: Where it lets go.
    """
    base, found = arm.robot.placement.base, list[tuple[float, float]]()
    for more in (0.0, math.pi):
        turned = Pose2(grip.x, grip.y, grip.yaw + more)
        one, other = start @ turned, end @ turned
        posture = arm.solve_posture(top_down(*_stand(one, MEETING_HEIGHT_M)))
        if posture is not None:
            swing = _bearing(base, other) - _bearing(base, one)
            first = float(posture[-1])
            last = first - wrap(other.yaw - one.yaw - swing)
            found.append((max(abs(first), abs(last)), more))
    more = min(found, default=(0.0, 0.0))[1]
    return Pose2(grip.x, grip.y, grip.yaw + more)


def _bearing(base: Pose2, at: Pose2) -> float:
    return math.atan2(at.y - base.y, at.x - base.x)


def _take(runner: "SkillRunner", arm: ArmMotion, joint: Joint) -> Motion:
    """Take the thing from the partner, and put it down."""
    moves, scene, name = Moves(arm), arm.scene, arm.robot.name
    yield from reserve_together(runner, arm, joint)
    part, thing = joint.subtasks[name], joint.thing
    assert joint.meeting is not None
    at = joint.meeting.inverse() @ part.pick
    grip = _turned(arm, at, joint.meeting, joint.end)
    wait = _stand(joint.meeting @ grip, MEETING_HEIGHT_M + _ABOVE_M)
    put_m = _support_m(runner, joint) + _grip_m(joint)
    put = _stand(joint.end @ grip, put_m)
    for stand in (wait, (*wait[:2], MEETING_HEIGHT_M, wait[3])):
        moves.check_reach(stand, "meeting")
    for stand in (put, _stand(joint.end @ grip, max(put_m, TRAVEL_HEIGHT_M))):
        moves.check_reach(stand, "place")
    runner.feel(arm, part.pick, thing)
    arm.opening_m = FINGER_OPENING_M
    yield from moves.to(wait)
    yield from joint.meet(name, scene)
    low = _end_of(runner, joint, grip)
    yield from moves.grasp((*low[:2], low[2] + _ABOVE_M, low[3]), low)
    yield from joint.meet(name, scene)
    yield from joint.meet(name, scene)
    moves.check_held()
    hand = arm.tcp_pose()
    x, y, z = hand[:3, 3].tolist()
    now = Pose2(x, y, math.atan2(hand[1, 0], hand[0, 0]))
    held = scene.pose2(thing).inverse() @ now
    above_m = z - _end_m(runner, joint, held)
    yield from _put_down(runner, arm, joint, joint.end @ held, above_m)


def _put_down(
    runner: "SkillRunner", arm: ArmMotion, joint: Joint, at: Pose2, above_m: float
) -> Motion:
    """Put the held thing down, with the hand at a pose, and rise.

    Args:
        runner: The runner.
        arm: Of the robot that holds it.
        joint: The sub-task.
        at: Of the hand at the end.
        above_m: Height of the hand above the axis of the thing where it holds it [m].
    """
    moves, kind = Moves(arm), kind_of(joint.thing)
    low_m = _support_m(runner, joint) + kind.origin_m + above_m - _PRESS_M
    put = _stand(at, low_m)
    over = _stand(at, max(low_m, TRAVEL_HEIGHT_M))
    for stand in (put, over):
        moves.check_reach(stand, "place")
    runner.feel(arm, at, joint.thing)
    yield from moves.to(over, fly_by=True)
    moves.check_held()
    yield from moves.lower(put, contact=True)
    yield from moves.release(put)


def _stand(at: Pose2, height_m: float) -> Stand:
    return (at.x, at.y, height_m, at.yaw)


def _grip_m(joint: Joint) -> float:
    """Return how high a hand holds the thing above its bottom [m]."""
    ends = kind_of(joint.thing).ends
    assert ends is not None
    return ends[0].height_m


def _bottom_m(runner: "SkillRunner", joint: Joint) -> float:
    """Return the height of the thing's bottom now, in its middle [m]."""
    height_m = float(runner.scene.position(joint.thing)[2])
    return height_m - kind_of(joint.thing).origin_m


def _end_m(runner: "SkillRunner", joint: Joint, grip: Pose2) -> float:
    """Return the height of the thing's axis where a hand holds it, as it tilts [m]."""
    pose = runner.scene.pose(joint.thing)
    w, x, y, z = pose.quaternion
    return float(pose.position[2] + 2.0 * (x * z - w * y) * grip.x)


def _end_of(runner: "SkillRunner", joint: Joint, grip: Pose2) -> Stand:
    """Return the hand that holds the end of the thing, where that is now."""
    above_m = _grip_m(joint) - kind_of(joint.thing).origin_m
    at = runner.scene.pose2(joint.thing) @ grip
    return _stand(at, _end_m(runner, joint, grip) + above_m)


def _support_m(runner: "SkillRunner", joint: Joint) -> float:
    """Return the height of what the thing shall be put on [m]."""
    body = runner.scene.model.body(joint.thing).id
    return max(
        runner.surface(at, exclude=body)[0]
        for at in kind_of(joint.thing).rests(joint.end)
    )
