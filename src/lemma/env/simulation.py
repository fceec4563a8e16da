"""The step loop: physics, servos and skills, one servo tick at a time.

This is the only place that steps the physics. The expert, the environments, data
generation and viewers all drive it. Code that wants to watch registers an observer.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidActionError, PhysicsError, UnknownNameError
from lemma.core.poses import FloatArray
from lemma.env.snapshots import (
    ArmSnapshot,
    Ended,
    RobotClock,
    Running,
    SimulationSnapshot,
    Watch,
    broken_off,
    outcome_of,
    with_losses,
)
from lemma.motion.arm_motion import ArmMotion
from lemma.motion.leaving import NOTHING_LEAVES
from lemma.motion.outcome import SkillResult
from lemma.motion.reservations import Reservations
from lemma.motion.skills import SkillRunner
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.build import STEPS_PER_TICK, TICK_S, TIME_STEP_S
from lemma.scene.coasting import follow, look, step
from lemma.scene.overlaps import check_layout
from lemma.scene.scene import Scene
from lemma.scene.spec import SceneSpec
from lemma.tasks.subtask import GroundedSubTask

HORIZON_S = 100.0
"""T_max: simulated seconds after which an episode ends (paper, section IV)."""

Pace = Callable[[str, float, float], float]
"""From a robot, when its sub-task began and the present [s] to how fast it is: 1 as
usual, 0.5 half as fast, 0 at rest."""

_SETTLE_TICKS = 30


class Simulation:
    """A scene in motion."""

    def __init__(self, spec: SceneSpec, actuation: str = "position") -> None:
        """Compile a scene, park the arms and let the objects come to rest.

        Args:
            spec: The scene.
            actuation: ``"position"``, ``"velocity"`` or ``"torque"``.

        Raises:
            UnknownNameError: No such actuation.
            InvalidConfigError: Things overlap, or do not lie on the table.
        """
        self.scene = Scene(spec, actuation)
        self.arms = {
            robot.name: ArmMotion(self.scene, robot) for robot in self.scene.robots
        }
        self.clocks = {name: RobotClock() for name in self.arms}
        self.observers: list[Callable[[], None]] = []
        """Called after every servo tick."""
        self.watch: Watch | None = None
        """Called before them, when it is due."""
        self.fault: Callable[[], str | None] = lambda: None
        """Returns why the episode has failed, if that breaks off what robots do."""
        self.pace: Pace | None = None
        """How fast busy robots are; all as fast as they can if None."""
        self._skills = SkillRunner(self.arms)
        self._running: dict[str, Running] = {}
        self._control: FloatArray = self.scene.data.ctrl
        self._commands = np.empty((STEPS_PER_TICK, self.scene.model.nu))
        self._follow = partial(follow, self.scene.physics, self._commands)
        for arm in self.arms.values():
            self.scene.set_joints(arm.robot, arm.park, FINGER_OPENING_M)
            arm.sync()
            arm.follow_posture(arm.park)
        check_layout(self.scene)
        self._settle()

    def _settle(self) -> None:
        """Let the objects sink into their resting contact, then call that time zero."""
        for _ in range(_SETTLE_TICKS):
            mujoco.mj_step(self.scene.model, self.scene.data, STEPS_PER_TICK)
        self.scene.check_memory()
        self.scene.data.time = 0.0

    @property
    def reservations(self) -> Reservations:
        """The sectors of the table that robots at work hold."""
        return self._skills.reservations

    @property
    def time_s(self) -> float:
        """Simulated time since the first state [s]."""
        return self.scene.time_s

    def tick(self, active: tuple[str, ...] = ()) -> None:
        """Advance by one servo tick.

        Args:
            active: Robots whose reference moves under RMPflow; the servos of the others
                keep their last command.

        Raises:
            PhysicsError: The state has become infinite, or no number at all.
        """
        # The reference of RMPflow does not depend on the physics within a tick.
        self._commands[:] = self._control
        for name in active:
            self.arms[name].lead(self._commands)
        self._pass(self._follow, 1)

    def run(self, work: Callable[[int], None], ticks: int) -> None:
        """Advance by servo ticks in which a controller commands the motors.

        Args:
            work: Runs a number of servo ticks, with :func:`lemma.scene.coasting.step`
                and :func:`~lemma.scene.coasting.look`.
            ticks: Number of servo ticks.

        Raises:
            PhysicsError: The state has become infinite, or no number at all.
        """
        while ticks > 0:
            count = 1 if self.observers else ticks
            if self.watch is not None:
                count = min(count, self.watch.due_ticks)
            self._pass(work, count)
            ticks -= count

    def _pass(self, work: Callable[[int], None], ticks: int) -> None:
        """Run servo ticks without observers in between."""
        data = self.scene.data
        start = data.time
        work(ticks)
        # MuJoCo resets a state that diverges, its time included.
        if not data.time > start + ticks * TICK_S - 0.5 * TIME_STEP_S:
            raise PhysicsError(
                f"The physics became unstable {start:g} s after the beginning, and "
                "what is simulated means nothing any more. Reset before you go on."
            )
        if self.watch is not None:
            self.watch.look(ticks)
        for observer in self.observers:
            observer()

    def execute(
        self, subtask: GroundedSubTask, until_s: float = HORIZON_S
    ) -> SkillResult:
        """Execute a grounded sub-task to its end, while no other robot works.

        Args:
            subtask: The sub-task.
            until_s: Simulated time at which to break it off [s].

        Raises:
            InvalidActionError: A robot is busy.
            UnknownNameError: There is no such robot in this scene.
        """
        if self._running:
            raise InvalidActionError(
                f"{subtask.robot} cannot work alone: {', '.join(self._running)} is "
                "busy. Call advance() until no robot is."
            )
        self._begin(subtask, until_s)
        return self.advance()[0].result

    def begin(
        self,
        subtask: GroundedSubTask,
        until_s: float = HORIZON_S,
        leaving: Mapping[str, str] = NOTHING_LEAVES,
    ) -> None:
        """Give a grounded sub-task to a free robot; :meth:`advance` carries it out.

        Arms that stay over the table, free, make way for it where they must.

        Args:
            subtask: The sub-task.
            until_s: Simulated time at which to break it off [s].
            leaving: Things that must be gone before it puts something down there, each
                with the robot that takes it away.

        Raises:
            InvalidActionError: The robot is busy.
            UnknownNameError: There is no such robot in this scene.
        """
        if not self._running:
            self._skills.staying.begin()
        self._begin(subtask, until_s, leaving)

    def _begin(
        self,
        subtask: GroundedSubTask,
        until_s: float,
        leaving: Mapping[str, str] = NOTHING_LEAVES,
    ) -> None:
        if subtask.robot not in self.arms:
            raise UnknownNameError("robot in this scene", subtask.robot, self.arms)
        joint = self._skills.pair_up(subtask)
        parts = {subtask.robot: subtask} if joint is None else joint.subtasks
        busy = next((robot for robot in parts if robot in self._running), None)
        if busy is not None:
            raise InvalidActionError(
                f"{busy} is busy. Only a free robot can begin a sub-task."
            )
        for robot, part in parts.items():
            self._skills.staying.work(robot)
            self._skills.leaving.note(robot, leaving)
            if joint is not None:
                self._skills.joints[robot] = joint
            self._running[robot] = Running(
                *(part, self._skills.run(part), self.time_s, until_s),
                self.scene.fallen,
                partner="" if joint is None else joint.partner_of(robot),
                leads=part is subtask,
            )

    def partner_of(self, subtask: GroundedSubTask) -> str:
        """Return the robot that a sub-task takes besides its own; empty for none."""
        joint = self._skills.pair_up(subtask)
        return "" if joint is None else joint.partner_of(subtask.robot)

    @property
    def busy(self) -> dict[str, GroundedSubTask]:
        """The sub-tasks being executed, by robot, in the order of the team."""
        running = self._running
        return {name: running[name].subtask for name in self.arms if name in running}

    def advance(self, until_s: float = math.inf) -> tuple[Ended, ...]:
        """Let time pass until a busy robot becomes free.

        Args:
            until_s: Simulated time at which to return at the latest [s]; robots that
                are busy then stay so.

        Returns:
            The sub-tasks that ended, all at the present time; several where they ended
            in the same tick, none where ``until_s`` came first or no robot is busy.
        """
        data, end = self.scene.data, until_s - 0.5 * TIME_STEP_S
        while self._running:
            ended = self._end_those_done()
            if ended or data.time >= end:
                return ended
            try:
                self.tick((*self._running, *self._mind_others()))
            except BaseException:
                # An observer may break everything off by raising something.
                while self._running:
                    self._free(next(iter(self._running)))
                raise
        return ()

    def _keep_pace(self, robot: str) -> float:
        """Set and return how fast a busy robot is now."""
        arm, running = self.arms[robot], self._running[robot]
        if self.pace is not None:
            pair = filter(None, (robot, running.partner))
            # Two that carry one thing are as slow as the slower one.
            start_s, now_s = running.start_s, self.time_s
            arm.pace = min(self.pace(name, start_s, now_s) for name in pair)
        return arm.pace

    def _mind_others(self) -> tuple[str, ...]:
        """Let those at work mind each other; returns free arms that make way."""
        staying = self._skills.staying
        if len(self._running) > 1 or staying:
            self._skills.mind_others(tuple(self._running))
        return staying.make_way() if staying else ()

    def _end_those_done(self) -> tuple[Ended, ...]:
        """Let every skill look at the present state once; free robots that are done."""
        ended, now_s = [], self.time_s
        for name in [name for name in self.arms if name in self._running]:
            if name not in self._running:
                # It ended with its partner.
                continue
            running = self._running[name]
            try:
                if running.looks(now_s, self._keep_pace(name)):
                    next(running.skill)
            except StopIteration as done:
                running.result = running.result or done.value
            except BaseException:
                self._free(name)
                raise
            other = self._running.get(running.partner)
            result = outcome_of(running, other, now_s)
            thrown, fault = self.scene.coasting.thrown, self.fault()
            result = result or broken_off(running, now_s, thrown, fault)
            if result is not None:
                ended.append(self._end(name, result))
        return tuple(ended)

    def _end(self, robot: str, result: SkillResult) -> Ended:
        """Free a robot, and its partner, and return what has ended."""
        running = self._running[robot]
        if not running.leads:
            running = self._running[running.partner]
        self._free(robot)
        fell = [name for name in self.scene.fallen if name not in running.fallen]
        result = with_losses(result, fell)
        return Ended(running.subtask, result, running.start_s)

    def _free(self, robot: str) -> None:
        """End what a robot does, and its partner; count the time it took."""
        running = self._running.pop(robot)
        if running.partner in self._running:
            self._free(running.partner)
        self._skills.joints.pop(robot, None)
        running.skill.close()
        self.arms[robot].pace = 1.0
        self._skills.staying.leave(robot)
        if not self._running:
            self._skills.staying.clear()
        self.clocks[robot].busy_s += self.time_s - running.start_s

    def rest(self, seconds: float) -> None:
        """Let time pass without moving any arm."""
        self._commands[:] = self._control
        self.run(self._follow, math.ceil(seconds / TICK_S))

    def stand_still(self, seconds: float) -> None:
        """Let time pass while every arm brakes and then stays where it is."""
        if self.scene.actuation == "torque":
            self.run(self._brake, math.ceil(seconds / TICK_S))
            return
        if self.scene.actuation == "velocity":
            for arm in self.arms.values():
                self._control[arm.robot.ctrl] = 0.0
        self.rest(seconds)

    def _brake(self, ticks: int) -> None:
        """Run servo ticks with torques against the joints' speeds; motors limit it."""
        data = self.scene.data
        for _ in range(ticks):
            for _ in range(STEPS_PER_TICK):
                for arm in self.arms.values():
                    damping = np.array(arm.robot.arm.damping)
                    data.ctrl[arm.robot.ctrl] = -damping * data.qvel[arm.robot.dof]
                step(self.scene.physics)
            look(self.scene.physics)

    def snapshot(self) -> SimulationSnapshot:
        """Return all that the future depends on.

        Raises:
            InvalidActionError: A robot is busy: a motion in its midst cannot be saved.
        """
        if self._running:
            raise InvalidActionError(
                f"{', '.join(self._running)} is busy, and a sub-task in its midst "
                "cannot be saved. Call advance() until no robot is."
            )
        arms = {
            name: ArmSnapshot(
                arm.state.copy(),
                arm.workspace.goal,
                arm.opening_m,
                self.clocks[name].busy_s,
            )
            for name, arm in self.arms.items()
        }
        coasting, waiting = self.scene.coasting.state(), self.reservations.times.copy()
        return SimulationSnapshot(self.scene.snapshot(), arms, coasting, waiting)

    def restore(self, snapshot: SimulationSnapshot) -> None:
        """Go back to a snapshot; what follows is equal to the bit. No robot is busy."""
        for running in self._running.values():
            running.skill.close()
        self._running.clear()
        self._skills.joints.clear()
        self._skills.staying.clear()
        self.reservations.clear(snapshot.waiting)
        self.scene.restore(snapshot.physics)
        self.scene.coasting.restore(snapshot.coasting)
        # The contacts too, which tell what is held.
        mujoco.mj_fwdPosition(self.scene.model, self.scene.data)
        for name, saved in snapshot.arms.items():
            arm = self.arms[name]
            arm.state[:] = saved.reference
            arm.workspace.goal, arm.opening_m = saved.goal, saved.opening_m
            self.clocks[name].busy_s = saved.busy_s

    def held(self) -> dict[str, str]:
        """Return what each gripper holds: robot name to entity name.

        An object is held when both finger pads of a gripper touch it.
        """
        return self.scene.held()
