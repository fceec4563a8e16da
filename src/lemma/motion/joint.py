"""Sub-tasks that two robots carry out together, on one clock.

The order is given to one robot, the leader, and takes a partner as well. Both reserve
all that they will sweep at once or wait without any sector, so that no circle of
waiting arms goes through them. Where one robot fails, the other one ends with the same
outcome.

``carry``: the partner is the robot that stands nearest to the other handle. Each grasps
its handle and waits for the other one. From there on a single path of the thing sets
both references, a posture for each servo tick by inverse kinematics. ``give`` is in
:mod:`lemma.motion.give`.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

from lemma.core.poses import Pose2, wrap
from lemma.motion.arm_motion import ArmMotion
from lemma.motion.moves import Motion, Moves, Stand
from lemma.motion.outcome import Outcome, SkillFailure
from lemma.robots.reach import TRAVEL_HEIGHT_M, reach_of
from lemma.robots.ur.kinematics import top_down
from lemma.scene.build import TICK_S
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.kind import Carried, Grasp, ObjectKind
from lemma.scene.scene import Scene
from lemma.scene.spec import RobotPlacement
from lemma.tasks.subtask import GroundedSubTask, Primitive

if TYPE_CHECKING:
    from lemma.motion.skills import SkillRunner

CARRY_M_S = 0.2
"""Speed at which two robots carry a thing, on average over each part of the way."""
_HANDLE_M = 0.06
"""A pick pose means a handle if it is no farther from it than this [m]."""
_TURN_M = 0.3
"""A turn by one radian takes as long as a way of this length."""
_PRESS_M = 0.0005
_SETTLE_TICKS = 15


@dataclass(slots=True)
class Joint:
    """Two robots and the thing that they carry, or that one gives to the other."""

    thing: str
    subtasks: Mapping[str, GroundedSubTask]
    """That of each robot, the leader's first."""
    start: Pose2
    """Where the thing lies."""
    end: Pose2
    """Where it shall lie."""
    meeting: Pose2 | None = None
    """Where it is in the air as it changes hands; None for ``carry``."""
    failure: SkillFailure | None = None
    """Why one of the robots cannot go on."""
    _met: dict[str, int] = field(default_factory=dict)
    _opened_s: dict[int, float] = field(default_factory=dict)

    @property
    def leader(self) -> str:
        """The robot that was given the order."""
        return next(iter(self.subtasks))

    @property
    def carried(self) -> Carried:
        """How the thing is carried."""
        carried = kind_of(self.thing).carried
        assert carried is not None
        return carried

    @property
    def goals(self) -> dict[str, tuple[Pose2, Pose2]]:
        """Where each robot has its hand first and last, by robot."""
        goals = {name: (part.pick, part.place) for name, part in self.subtasks.items()}
        if self.meeting is not None:
            pick = goals[self.leader][0]
            goals[self.leader] = (pick, self.meeting @ self.start.inverse() @ pick)
        return goals

    def partner_of(self, robot: str) -> str:
        """Return the other robot."""
        return next(name for name in self.subtasks if name != robot)

    def meet(self, robot: str, scene: Scene) -> Motion:
        """Wait until the partner is here as well; both go on in the same tick."""
        count = self._met[robot] = self._met.get(robot, 0) + 1
        if self._met.get(self.partner_of(robot), 0) >= count:
            self._opened_s[count] = scene.time_s
        while scene.time_s <= self._opened_s.get(count, math.inf):
            yield

    def share(self, motion: Motion) -> Motion:
        """Carry out a robot's part; a failure of either is that of both.

        Raises:
            SkillFailure: This robot or its partner cannot go on.
        """
        try:
            for _ in motion:
                if self.failure is not None:
                    raise SkillFailure(self.failure.outcome, self.failure.explanation)
                yield
        except SkillFailure as failure:
            self.failure = self.failure or failure
            raise

    def path(self, lift_m: float, end_m: float) -> Iterator[tuple[Pose2, float]]:
        """Yield pose and height of the thing along up, over and down, one per tick.

        Args:
            lift_m: Height that it is raised to, above where it lies [m].
            end_m: Height at which it is put down, above where it lies [m].
        """
        corners = (
            (self.start, 0.0),
            (self.start, lift_m),
            (self.end, lift_m),
            (self.end, end_m),
        )
        for (a, low), (b, high) in pairwise(corners):
            turn = wrap(b.yaw - a.yaw)
            way = max(a.distance(b), abs(high - low), _TURN_M * abs(turn))
            # A cubic ease peaks at 1.5 times its mean speed.
            ticks = max(2, round(1.5 * way / CARRY_M_S / TICK_S))
            for i in range(1, ticks + 1):
                t = i / ticks
                t = t * t * (3.0 - 2.0 * t)
                x, y = a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)
                yield Pose2(x, y, a.yaw + t * turn), low + t * (high - low)


def pair_up(subtask: GroundedSubTask, scene: Scene, thing: str | None) -> Joint | None:
    """Return who carries a thing with a robot or is given it, and how.

    Args:
        subtask: The robot's, with the poses of its own hand. The place pose of ``give``
            is where that hand would be if it held the thing to the end.
        scene: The world.
        thing: The entity at its pick pose.

    Returns:
        None if it is no joint sub-task, or the pose is not that of a handle.
    """
    grips = None if thing is None else _grips(subtask.primitive, kind_of(thing))
    if grips is None or thing is None or thing in scene.fallen:
        return None
    robots = {robot.name: robot.placement for robot in scene.robots}
    if len(robots) < 2:
        return None
    start = scene.pose2(thing)
    mine, other = sorted(
        (grasp.at for grasp in grips),
        key=lambda at: subtask.pick.distance(start @ at),
    )
    if subtask.pick.distance(start @ mine) > _HANDLE_M:
        return None
    end = subtask.place @ subtask.pick.inverse() @ start
    gives = subtask.primitive is Primitive.GIVE
    bases = {name: placed.base for name, placed in robots.items()}
    partner = nearest_robot(bases, (end if gives else start) @ other, subtask.robot)
    assert partner is not None
    pair = (robots[subtask.robot], robots[partner])
    met = meeting(*pair, mine, other) if gives else None
    theirs = GroundedSubTask(
        partner, subtask.primitive, (met or start) @ other, end @ other
    )
    return Joint(thing, {subtask.robot: subtask, partner: theirs}, start, end, met)


def _grips(primitive: Primitive, kind: ObjectKind) -> tuple[Grasp, Grasp] | None:
    """Return how two hands hold a kind of thing in a joint sub-task, if they can."""
    if primitive is Primitive.GIVE:
        return kind.ends
    carries = primitive is Primitive.CARRY and kind.carried is not None
    return kind.handles if carries else None


def meeting(
    giver: RobotPlacement, taker: RobotPlacement, mine: Pose2, other: Pose2
) -> Pose2:
    """Return where a thing is in the air as it changes hands.

    It lies along the line between both bases, the giver's end towards the giver. Both
    hands are equally far inside of what they reach.

    Args:
        giver: The robot that brings it.
        taker: The robot that takes it.
        mine: Where the giver holds it, in its frame.
        other: Where the taker holds it, in its frame.
    """
    base, towards = giver.base, taker.base
    reach, theirs = (reach_of(placed.arm).travel_m for placed in (giver, taker))
    way = base.distance(towards) - mine.distance(other)
    out_m = 0.5 * (way + reach - theirs)
    bearing = math.atan2(towards.y - base.y, towards.x - base.x)
    hand = Pose2(base.x, base.y, bearing) @ Pose2(out_m, 0.0)
    along = math.atan2(other.y - mine.y, other.x - mine.x)
    return hand @ Pose2(0.0, 0.0, -along) @ Pose2(-mine.x, -mine.y)


def nearest_robot(bases: Mapping[str, Pose2], at: Pose2, but: str) -> str | None:
    """Return the robot that stands nearest to a place; None if there is no other.

    Args:
        bases: Of all robots, by name.
        at: The place.
        but: A robot that is left out.
    """
    others = [name for name in bases if name != but]
    return min(others, key=lambda name: bases[name].distance(at), default=None)


def turned_for(arm: ArmMotion, grip: Pose2, at: Pose2) -> Pose2:
    """Return a grip, half a turn on where that turns the arm less.

    Args:
        arm: The arm.
        grip: The hand in the frame of the thing.
        at: Where the thing lies.
    """
    gripper, yaw = arm.tcp_pose(), (at @ grip).yaw
    turn = math.pi + yaw - math.atan2(gripper[1, 0], gripper[0, 0])
    more = 0.0 if abs(wrap(turn)) >= 0.5 * math.pi else math.pi
    return Pose2(grip.x, grip.y, grip.yaw + more)


class Hold:
    """One robot's part of a joint sub-task: its handle, wherever the thing is."""

    def __init__(self, arm: ArmMotion, joint: Joint, support_m: float) -> None:
        """Look where the handle is.

        Args:
            arm: Of one of the two robots.
            joint: The sub-task.
            support_m: Height of what the thing shall be put on [m].
        """
        self._arm, self._moves, self._joint = arm, Moves(arm), joint
        self.subtask = joint.subtasks[arm.robot.name]
        grip = joint.start.inverse() @ self.subtask.pick
        self._grip = turned_for(arm, grip, joint.start)
        bottom = arm.scene.position(joint.thing)[2] - kind_of(joint.thing).origin_m
        self._low_m = bottom + joint.carried.handles[0].height_m
        self._lift_m = max(0.0, TRAVEL_HEIGHT_M - self._low_m)
        self._end_m = support_m - bottom - _PRESS_M

    def check_reach(self) -> None:
        """Fail where the arm cannot follow the whole way.

        Raises:
            SkillFailure: It cannot.
        """
        joint, path = self._joint, list(self._path())
        self._moves.check_reach(self._stand(joint.start, 0.0), "pick")
        for pose, height_m in (*path[::20], path[-1]):
            self._moves.check_reach(self._stand(pose, height_m), "place")

    def grasp(self) -> Motion:
        """Take hold of the handle."""
        start = self._joint.start
        over = self._stand(start, self._lift_m)
        yield from self._moves.grasp(over, self._stand(start, 0.0))

    def follow(self) -> Motion:
        """Lead the hand along the path of the thing; begin with the partner."""
        arm = self._arm
        for pose, height_m in self._path():
            posture = arm.solve_posture(top_down(*self._stand(pose, height_m)))
            if posture is None:
                raise SkillFailure(
                    Outcome.UNREACHABLE,
                    f"{arm.robot.name} cannot follow the {self._joint.thing}.",
                )
            arm.state[0], arm.state[1] = posture, 0.0
            arm.hold()
            self._moves.check_tracking()
            self._moves.check_held()
            yield
        for _ in range(_SETTLE_TICKS):
            yield

    def release(self) -> Motion:
        """Open the hand and rise."""
        yield from self._moves.release(self._stand(self._joint.end, self._end_m))

    def _path(self) -> Iterator[tuple[Pose2, float]]:
        return self._joint.path(self._lift_m, self._end_m)

    def _stand(self, thing: Pose2, height_m: float) -> Stand:
        hand = thing @ self._grip
        return (hand.x, hand.y, self._low_m + height_m, hand.yaw)


def carry(runner: "SkillRunner", arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
    """Carry an object by one handle, while the partner does the same at the other one.

    Raises:
        SkillFailure: There is no handle at the pick pose, or one of both failed.
    """
    joint = runner.joints.get(arm.robot.name)
    if joint is None:
        raise SkillFailure(
            Outcome.INVALID,
            f"{subtask.primitive} takes two robots and an object with two handles, but "
            f"there is no handle at ({subtask.pick.x:.3f}, {subtask.pick.y:.3f}).",
        )
    yield from joint.share(_carry_together(runner, arm, joint))


def _carry_together(runner: "SkillRunner", arm: ArmMotion, joint: Joint) -> Motion:
    name, scene = arm.robot.name, arm.scene
    yield from reserve_together(runner, arm, joint)
    hold = Hold(arm, joint, _support_m(runner, joint))
    hold.check_reach()
    runner.feel(arm, hold.subtask.pick, joint.thing)
    yield from hold.grasp()
    yield from joint.meet(name, scene)
    runner.feel(arm, hold.subtask.place, joint.thing)
    yield from hold.follow()
    yield from joint.meet(name, scene)
    yield from hold.release()


def reserve_together(runner: "SkillRunner", arm: ArmMotion, joint: Joint) -> Motion:
    """Wait until both robots are free and have reserved all that they will sweep."""
    name, scene, table = arm.robot.name, arm.scene, runner.reservations
    if table.holds(name):
        # A robot that waits holds no sector, so no cycle of waiting arms includes it.
        yield from runner.staying.go_home(arm)
        table.give_up(name)
    yield from joint.meet(name, scene)
    if name == joint.leader:
        yield from runner.wait_for(arm, partial(table.ask_together, joint.goals))
    yield from joint.meet(name, scene)


def _support_m(runner: "SkillRunner", joint: Joint) -> float:
    """Return the height of what the object shall be put on [m]."""
    body, rest_m = runner.scene.model.body(joint.thing).id, joint.carried.rest_m
    return max(
        runner.surface(joint.end @ Pose2(side * rest_m, 0.0), exclude=body)[0]
        for side in (-1.0, 1.0)
    )
