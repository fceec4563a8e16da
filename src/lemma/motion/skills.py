"""Execution of primitives: waypoints for RMPflow, gripper commands, failures.

A skill is a generator that reads the state, sets goals, and yields once per servo tick.
The step loop in ``env`` advances the physics. Except for successful ``reach`` and
``lift``, the robot is parked with an empty gripper afterwards, also after a failure.
"""

from collections.abc import Callable, Generator

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.poses import Pose2
from lemma.core.registry import Registry
from lemma.motion.arm_motion import ArmMotion, largest_turn
from lemma.motion.give import give
from lemma.motion.joint import Joint, carry, pair_up
from lemma.motion.leaving import Leaving
from lemma.motion.moves import FLY_BY_M, Motion, Moves, Stand, between
from lemma.motion.obstacles import Obstacles
from lemma.motion.outcome import Outcome, SkillFailure, SkillResult, has_fallen
from lemma.motion.reservations import Reservations, Verdict
from lemma.motion.stands import as_it_turns, withdrawal
from lemma.motion.staying import HOME_RAD, StayingArms
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.robots.ur.kinematics import top_down
from lemma.scene.build import TICK_S
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.kind import Grasp
from lemma.scene.objects.stick import STICK_GRASP_HEIGHT_M
from lemma.tasks.subtask import JOINT, GroundedSubTask, Primitive

Skill = Generator[None, None, SkillResult]

DRAG_HEIGHT_M = 0.022
"""Height at which the stick pushes or pulls: it is 4 mm above the table."""
DRAG_SPEED_M_S = 0.2

_MIND_TICKS = 5
"""Servo ticks between two updates of the reservations: 50 ms."""
_MEETING_M = 0.05
_MEETING_M_S = 0.1
"""Speed at which the stick makes contact: a faster stick would knock the cube away."""
_HOVER_M = 0.05
_LIFT_M = 0.15
_PRESS_M = 0.0005
"""Depth below first contact to which a held object is lowered, so that it never falls.
"""


class SkillRunner:
    """Executes grounded sub-tasks with the arms of one scene."""

    def __init__(self, arms: dict[str, ArmMotion]) -> None:
        """Execute sub-tasks with the given arms.

        Args:
            arms: Motion of every robot of the scene, by robot name.
        """
        self.arms = arms
        self.scene = next(iter(arms.values())).scene
        self.reservations = Reservations(arms)
        """Reservations of busy robots, and of free robots that are not parked."""
        self._obstacles = Obstacles(arms)
        self.leaving = Leaving(arms, self.reservations)
        self.staying = StayingArms(arms, self.reservations, self._obstacles)
        self.joints: dict[str, Joint] = {}
        """Joint sub-tasks under way, by each of their robots."""

    def feel(self, arm: ArmMotion, target: Pose2 | None, held: str | None) -> None:
        """Set the obstacles of an arm; see :meth:`.Obstacles.around`."""
        self._obstacles.feel(arm, target, held)

    def mind_others(self, busy: tuple[str, ...]) -> None:
        """Update the obstacles of busy robots, and resolve deadlocks.

        Args:
            busy: Robots, in the order in which their sub-tasks began.
        """
        for name in busy:
            # Update all arms, including those whose sub-task began in this tick.
            self.feel(self.arms[name], *self._obstacles.felt[name])
        # The simulated time decides, so that a restored state continues identically.
        if round(self.scene.time_s / TICK_S) % _MIND_TICKS == 0:
            self.reservations.follow()
        if self.reservations.waits:
            self.reservations.judge(busy)

    def pair_up(self, subtask: GroundedSubTask) -> Joint | None:
        """Return who carries out a joint sub-task, and how; see :func:`.pair_up`."""
        thing = self.surface(subtask.pick)[1] if subtask.primitive in JOINT else None
        return pair_up(subtask, self.scene, thing)

    def _enter(
        self, arm: ArmMotion, *goals: Pose2, stick: bool
    ) -> Generator[None, None, bool]:
        """Wait until an arm has reserved the way to goals and home.

        Returns:
            Whether it had to wait.

        Raises:
            SkillFailure: A deadlock, or the wait was too long.
        """
        name, table = arm.robot.name, self.reservations
        return (
            yield from self.wait_for(arm, lambda: table.ask(name, goals, stick=stick))
        )

    def wait_for(
        self, arm: ArmMotion, ask: Callable[[], bool]
    ) -> Generator[None, None, bool]:
        """Wait until an arm has the sectors that it asks for; see :meth:`_enter`."""
        name, table, since = arm.robot.name, self.reservations, self.scene.time_s
        while not ask():
            wait = table.waits[name]
            if wait.verdict is Verdict.FAIL:
                raise SkillFailure(
                    Outcome.DEADLOCK,
                    f"{name} waited for {' and '.join(wait.holders)}, in vain.",
                )
            if wait.verdict is Verdict.RETREAT:
                arm.follow_posture(arm.park)
                if largest_turn(arm.measured, arm.park) < HOME_RAD:
                    table.give_up(name)
            yield
        return self.scene.time_s > since

    def _put_away(self, arm: ArmMotion) -> Motion:
        """Put the held object down here, as soon as the way home is reserved.

        A busy arm has reserved it already. An arm that is parked or stays over the
        table may have to wait for others.
        """
        while not self.reservations.ask_for_home(arm.robot.name):
            yield
        yield from Moves(arm).give_up()

    def run(self, subtask: GroundedSubTask) -> Skill:
        """Execute a sub-task; yield once per servo tick, return the result.

        An arm that still holds an object puts it down first. Afterwards the arm is
        parked with an open gripper, also after a failure; after successful ``reach``
        and ``lift`` it stays where it is.

        Raises:
            UnknownNameError: There is no skill for this primitive.
        """
        skill = SKILLS[subtask.primitive]
        start = self.scene.time_s
        arm = self.arms[subtask.robot]
        result = SkillResult(Outcome.SUCCESS, "Done.", 0.0)
        self._obstacles.felt[subtask.robot] = (None, None)
        if Moves(arm).is_full():
            x, y = arm.tcp_pose()[:2, 3].tolist()
            # The held object is no obstacle.
            self._obstacles.felt[subtask.robot] = (None, self.surface(Pose2(x, y))[1])
            yield from self._put_away(arm)
        try:
            yield from self._begin(arm, subtask)
            yield from skill(self, arm, subtask)
        except SkillFailure as failure:
            result = SkillResult(failure.outcome, failure.explanation, 0.0)
            yield from self._put_away(arm)
        self.reservations.ask_for_home(subtask.robot)
        if subtask.primitive not in _STAYS or not result.ok:
            self.feel(arm, None, None)
            yield from Moves(arm).park()
        return SkillResult(
            result.outcome, result.explanation, self.scene.time_s - start
        )

    def _begin(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        """Reserve the first stage, or all stages if the skill makes no reservations."""
        if subtask.primitive in JOINT:
            return
        stick = self.surface(subtask.pick)[1] == STICK
        asks = SKILLS[subtask.primitive] in (SkillRunner.move, SkillRunner.prepare)
        goals = (subtask.pick,) if asks else (subtask.pick, subtask.place)
        yield from self._enter(arm, *goals, stick=stick)

    def move(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        """Pick up the object at the pick pose, and put it down at the place pose."""
        held, grip_m = self.what_to_pick(subtask.pick)
        yield from self._carry(arm, subtask, held, grip_m)

    def reach(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        """Hold the open gripper over the object at the pick pose."""
        moves = Moves(arm)
        found, grip_m = self.what_to_pick(subtask.pick)
        subtask = as_it_turns(subtask, arm)
        over = stand_at(subtask.pick, max(grip_m, TRAVEL_HEIGHT_M))
        top_m = grip_m - _grasp_of(found).height_m + kind_of(found).height_m
        low = stand_at(subtask.pick, top_m + _HOVER_M)
        for pose in (low, over):
            moves.check_reach(pose, "pick")
        self.feel(arm, subtask.pick, found)
        arm.opening_m = FINGER_OPENING_M
        yield from moves.to(over, fly_by=True)
        yield from moves.lower(low)

    def lift(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        """Pick up the object at the pick pose, and hold it there."""
        moves = Moves(arm)
        held, grip_m = self.what_to_pick(subtask.pick)
        subtask = as_it_turns(subtask, arm)
        low = stand_at(subtask.pick, grip_m)
        over = stand_at(subtask.pick, max(grip_m, TRAVEL_HEIGHT_M))
        for pose in (low, over):
            moves.check_reach(pose, "pick")
        self.feel(arm, subtask.pick, held)
        yield from moves.grasp(over, low)
        yield from moves.rise(low, grip_m + _LIFT_M)
        yield from moves.to(stand_at(subtask.pick, grip_m + _LIFT_M))
        moves.check_held()

    def prepare(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        """Put the stick down at the place pose, where it will be used."""
        yield from self._carry(arm, subtask, *self._stick_to_pick(subtask))

    def _carry(
        self, arm: ArmMotion, subtask: GroundedSubTask, held: str, grip_m: float
    ) -> Motion:
        moves = Moves(arm)
        subtask = as_it_turns(subtask, arm)
        low = stand_at(subtask.pick, grip_m)
        over = stand_at(subtask.pick, max(grip_m, TRAVEL_HEIGHT_M))
        put = self._put_down(subtask.place, held, grip_m)
        over_put = stand_at(subtask.place, max(put[2], TRAVEL_HEIGHT_M))
        for pose in (low, over):
            moves.check_reach(pose, "pick")
        for pose in (put, over_put):
            moves.check_reach(pose, "place")
        name, stick = arm.robot.name, held == STICK
        alone = self.reservations.is_alone(name)
        self.feel(arm, subtask.pick, held)
        yield from moves.grasp(over, low)
        yield from moves.rise(low, over[2] - FLY_BY_M)
        moves.check_held()
        waited = yield from self._enter(arm, subtask.place, stick=stick)
        while self.leaving.is_occupied(name, subtask.place):
            yield from self.leaving.wait_at_home(arm, subtask.place)
            yield from self._enter(arm, subtask.place, stick=stick)
            waited = True
        if waited or not alone:
            # Meanwhile another robot may have put an object at the place.
            moves.check_held()
            put = self._put_down(subtask.place, held, grip_m)
            over_put = stand_at(subtask.place, max(put[2], TRAVEL_HEIGHT_M))
        self.feel(arm, subtask.place, held)
        yield from moves.to(over_put, fly_by=True)
        moves.check_held()
        yield from moves.lower(put, contact=True)
        yield from moves.release(put)

    def _put_down(self, place: Pose2, held: str, grip_m: float) -> Stand:
        """Return the gripper's pose at which the held object touches its support."""
        body, bottom = self.scene.model.body(held).id, grip_m - _grasp_of(held).height_m
        support = max(self.surface(at, body)[0] for at in kind_of(held).rests(place))
        return stand_at(place, support + grip_m - bottom - _PRESS_M)

    def drag(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        """Grasp the stick at the pick pose, and push or pull a cube with it."""
        moves = Moves(arm)
        held, _ = self._stick_to_pick(subtask)
        subtask = as_it_turns(subtask, arm)
        low = stand_at(subtask.pick, STICK_GRASP_HEIGHT_M)
        over = stand_at(subtask.pick, TRAVEL_HEIGHT_M)
        start = stand_at(subtask.pick, DRAG_HEIGHT_M)
        end = stand_at(subtask.place, DRAG_HEIGHT_M)
        for pose in (low, over):
            moves.check_reach(pose, "pick")
        moves.check_reach(end, "place")
        self.feel(arm, subtask.pick, held)
        yield from moves.grasp(over, low)
        yield from moves.to(start, contact=True)
        moves.check_held()
        met = between(start, end, _MEETING_M)
        yield from moves.along(start, met, _MEETING_M_S)
        yield from moves.along(met, end, DRAG_SPEED_M_S)
        yield from moves.to(end, contact=True)
        moves.check_held()
        last = end
        for stand in withdrawal(subtask.primitive, arm.robot.placement, start, end):
            if arm.solve_posture(top_down(*stand)) is not None:
                yield from moves.to(stand, contact=True)
                last = stand
        down = (last[0], last[1], STICK_GRASP_HEIGHT_M - _PRESS_M, last[3])
        yield from moves.to(down, contact=True)
        yield from moves.release(down)

    def _stick_to_pick(self, subtask: GroundedSubTask) -> tuple[str, float]:
        """Return the stick at the pick pose and its grasp height over the table [m]."""
        entity, grip_m = self.what_to_pick(subtask.pick)
        if entity != STICK:
            raise SkillFailure(
                Outcome.INVALID,
                f"{subtask.primitive} needs the stick, but {entity} is at the pick "
                "pose.",
            )
        return entity, grip_m

    def what_to_pick(self, pose: Pose2) -> tuple[str, float]:
        """Return the entity at a pick pose and its grasp height over the table [m].

        Raises:
            SkillFailure: No object there can be picked, or it has fallen off the table.
        """
        top, entity = self.surface(pose)
        if entity is not None and entity in self.scene.fallen:
            raise SkillFailure(Outcome.FALLEN, has_fallen(entity))
        if entity is None or entity not in self.scene.movable_names:
            found = entity or "the bare table"
            raise SkillFailure(
                Outcome.NOTHING_TO_PICK,
                f"Nothing to pick at ({pose.x:.3f}, {pose.y:.3f}): {found} is there.",
            )
        bottom = top - kind_of(entity).height_m
        return entity, bottom + _grasp_of(entity).height_m

    def surface(self, pose: Pose2, exclude: int = -1) -> tuple[float, str | None]:
        """Return the highest surface at a position, found by a ray from above.

        Args:
            pose: The position.
            exclude: MuJoCo body to ignore; robots are always ignored.

        Returns:
            Height of the surface above the table [m] and its entity, None for the
            table.
        """
        groups = np.array([1, 1, 0, 0, 0, 0], dtype=np.uint8)
        geom = np.array([-1], dtype=np.int32)
        start_z = 1.0
        self.scene.refresh()
        distance = mujoco.mj_ray(
            self.scene.model,
            self.scene.data,
            np.array([pose.x, pose.y, start_z]),
            np.array([0.0, 0.0, -1.0]),
            groups,
            1,
            exclude,
            geom,
        )
        if distance < 0:
            return 0.0, None
        body = int(self.scene.model.geom_bodyid[geom[0]])
        return max(0.0, start_z - distance), self.scene.entity_of_body(body)


def _grasp_of(entity: str) -> Grasp:
    """Return the grasp of an object; raise ``INVALID`` if there is none."""
    grasp = kind_of(entity).grasp
    if grasp is None:
        raise SkillFailure(Outcome.INVALID, f"No gripper can hold the {entity}.")
    return grasp


SkillMotion = Callable[[SkillRunner, ArmMotion, GroundedSubTask], Motion]
"""Executes a grounded sub-task; raises :class:`SkillFailure` if that fails."""

SKILLS: Registry[SkillMotion] = Registry("skill", SkillMotion)
"""The skill of each primitive; ``stop`` needs none."""
SKILLS.add(Primitive.MOVE, SkillRunner.move)
SKILLS.add(Primitive.PREHOOK, SkillRunner.prepare)
SKILLS.add(Primitive.HOOK, SkillRunner.drag)
SKILLS.add(Primitive.PREPOKE, SkillRunner.prepare)
SKILLS.add(Primitive.POKE, SkillRunner.drag)
SKILLS.add(Primitive.REACH, SkillRunner.reach)
SKILLS.add(Primitive.LIFT, SkillRunner.lift)
SKILLS.add(Primitive.CARRY, carry)
SKILLS.add(Primitive.GIVE, give)
_STAYS = (Primitive.REACH, Primitive.LIFT)
"""After these the arm stays where it is, and holds its object."""


def stand_at(pose: Pose2, z: float) -> Stand:
    """Return the waypoint over a pose on the table, at height ``z`` [m]."""
    return (pose.x, pose.y, z, pose.yaw)
