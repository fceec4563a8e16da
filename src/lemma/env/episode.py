"""One instance being executed: sub-tasks so far, time, success."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from lemma.core.arguments import real
from lemma.core.errors import InvalidConfigError, ResetNeededError
from lemma.env.simulation import HORIZON_S, Simulation
from lemma.env.snapshots import SimulationSnapshot
from lemma.env.stages import StageState, StageWatch
from lemma.motion.leaving import NOTHING_LEAVES
from lemma.motion.outcome import Outcome, SkillResult
from lemma.scene.build import TICK_S, TIME_STEP_S
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask
from lemma.tasks.teams.rule_watch import RuleState, RuleWatch

LEAST_STEP_S = 1.0
"""Simulated time that a step takes at least, so that every episode ends [s]."""
STILL_S = 1.0
"""How long an ended episode goes on, with its robots still, before it is judged [s]."""


@dataclass(frozen=True, slots=True)
class ExecutedSubTask:
    """One sub-task that was tried."""

    grounded: GroundedSubTask
    result: SkillResult
    start_s: float
    """Simulated time at which it began [s]."""


@dataclass(frozen=True, slots=True)
class BegunSubTask:
    """A sub-task that was given to a robot."""

    grounded: GroundedSubTask
    start_s: float
    """Simulated time at which it began [s]."""
    leaving: tuple[tuple[str, str], ...] = ()
    """Things that must be gone before it puts something down, and who takes them."""


@dataclass(frozen=True, slots=True)
class EpisodeSnapshot:
    """A moment of an episode; plain data, can be pickled.

    Where robots are busy it is the last moment at which none was, and all that has
    begun since then: a motion in its midst cannot be saved.
    """

    instance: Instance
    simulation: SimulationSnapshot
    stages: StageState
    executed: tuple[ExecutedSubTask, ...]
    stopped: bool
    ended_s: float | None
    """Simulated time at which it ended [s]; None while it goes on."""
    verdict: bool | None
    """Whether it succeeded; None before that was judged."""
    begun: tuple[BegunSubTask, ...] = ()
    """Sub-tasks given since, if robots are busy; restoring carries them out anew."""
    until_s: float = 0.0
    """Simulated time up to which they are carried out [s]."""
    rule: RuleState | None = None
    """State of the rule, if the goal has one."""


class Episode:
    """An executed instance, whoever decides what to do.

    When it ends, by ``stop`` or at the horizon, its robots stand still for
    :data:`STILL_S`; then it succeeds if the whole goal holds and nothing is held but
    what the goal says. That
    time is the judge's: ``elapsed_s`` does not count it. Before the end the same
    question is answered for the present moment. An episode in which an object was
    thrown (:mod:`lemma.scene.coasting`), or the rule of the goal broken
    (:mod:`lemma.tasks.teams.rule_watch`), ends then and has failed.
    """

    def __init__(
        self,
        instance: Instance,
        *,
        horizon_s: float = HORIZON_S,
        actuation: str = "position",
    ) -> None:
        """Set the table.

        Args:
            instance: The problem.
            horizon_s: T_max, simulated time after which the episode ends [s].
            actuation: How the motors are driven; skills need ``"position"``.

        Raises:
            InvalidConfigError: The horizon leaves no time, or things overlap or do not
                lie on the table.
            UnknownNameError: No such actuation.
        """
        self.instance = instance
        self.horizon_s = real("horizon_s", horizon_s, TICK_S)
        self.simulation = Simulation(instance.scene, actuation)
        self.stages = StageWatch(self.simulation, instance.goal)
        self.rule = _watch_rule(self.simulation, instance.goal)
        """Watches the rule of the goal; None where there is none."""
        self.executed: list[ExecutedSubTask] = []
        self.stopped = False
        self._ended_s: float | None = None
        self._verdict: bool | None = None
        self._quiet: EpisodeSnapshot | None = None
        self._begun: list[BegunSubTask] = []

    @property
    def elapsed_s(self) -> float:
        """Simulated time from the first state to the end, or until now [s]."""
        if self._ended_s is not None:
            return self._ended_s
        time_s: float = self.simulation.scene.data.time
        return time_s

    @property
    def out_of_time(self) -> bool:
        """Whether the horizon is reached."""
        return self.elapsed_s >= self.horizon_s - 0.5 * TIME_STEP_S

    @property
    def is_over(self) -> bool:
        """Whether somebody said ``stop``, the time is up or it has failed already."""
        return self.stopped or self.has_failed or self.out_of_time

    @property
    def has_failed(self) -> bool:
        """Whether an object was thrown, or the rule of the goal broken."""
        return self.is_thrown or self.broken is not None

    @property
    def broken(self) -> str | None:
        """How the rule of the goal was broken, if it was, as a sentence."""
        return None if self.rule is None else self.rule.broken

    @property
    def is_thrown(self) -> bool:
        """Whether it has failed because an object was thrown."""
        return self.simulation.scene.coasting.is_thrown

    @property
    def thrown(self) -> tuple[str, ...]:
        """Names of the objects that were thrown."""
        return self.simulation.scene.coasting.thrown

    @property
    def progress(self) -> float:
        """Share of the stages that are reached; see :mod:`lemma.env.stages`."""
        return self.stages.progress

    @property
    def goal_progress(self) -> float:
        """Fraction of the goal that holds now, in [0, 1]."""
        return self.instance.goal.progress(self.simulation.scene)

    @property
    def fallen(self) -> tuple[str, ...]:
        """Names of the objects that have fallen off the table: they are lost."""
        return self.simulation.scene.fallen

    @property
    def is_success(self) -> bool:
        """Whether it succeeded; before its end, whether it would if nothing changed."""
        return self.succeeds(self.goal_progress)

    def succeeds(self, goal_progress: float) -> bool:
        """Return :attr:`is_success` for the present share of the goal."""
        if self._verdict is not None:
            return self._verdict
        if self.has_failed or goal_progress < 1.0:
            return False
        return set(self.simulation.held().values()) <= self.instance.goal.held

    @property
    def failure(self) -> str | None:
        """Why the episode failed: an outcome, or ``"goal_not_reached"``; else None.

        None as well while the episode is not over.
        """
        if not self.is_over or self.is_success:
            return None
        if self.has_failed:
            return str(Outcome.THROWN if self.broken is None else Outcome.RULE)
        if self.out_of_time:
            return str(Outcome.OUT_OF_TIME)
        failed = [done.result.outcome for done in self.executed if not done.result.ok]
        return str(failed[-1]) if failed else "goal_not_reached"

    def check_running(self) -> None:
        """Raise :class:`ResetNeededError` if the episode is over."""
        if self.is_over:
            raise ResetNeededError(
                f"The episode {self.instance.key} is over. Reset before you act again."
            )

    def execute(self, grounded: GroundedSubTask) -> SkillResult:
        """Execute one grounded sub-task.

        Raises:
            ResetNeededError: The episode is over.
            UnknownNameError: There is no such robot in this scene.
        """
        self.check_running()
        start = self.elapsed_s
        result = self.simulation.execute(grounded, until_s=self.horizon_s)
        self.executed.append(ExecutedSubTask(grounded, result, start))
        self.conclude()
        return result

    def begin(
        self, grounded: GroundedSubTask, leaving: Mapping[str, str] = NOTHING_LEAVES
    ) -> None:
        """Give a grounded sub-task to a free robot, while others may be at work.

        Args:
            grounded: The sub-task.
            leaving: See :meth:`.Simulation.begin`.

        Raises:
            ResetNeededError: The episode is over.
            InvalidActionError: The robot is busy.
            UnknownNameError: There is no such robot in this scene.
        """
        self.check_running()
        if not self.simulation.busy:
            self._quiet, self._begun = self.snapshot(), []
        self.simulation.begin(grounded, self.horizon_s, leaving)
        there = tuple(leaving.items())
        self._begun.append(BegunSubTask(grounded, self.simulation.time_s, there))

    def advance(self, until_s: float = math.inf) -> tuple[ExecutedSubTask, ...]:
        """Let time pass until a busy robot becomes free.

        Args:
            until_s: Simulated time at which to return at the latest [s]; robots that
                are busy then stay so.

        Returns:
            The sub-tasks that ended; none where ``until_s`` came first or no robot is
            busy.
        """
        ended = tuple(
            ExecutedSubTask(one.subtask, one.result, one.start_s)
            for one in self.simulation.advance(until_s)
        )
        self.executed += ended
        if not self.simulation.busy:
            self.conclude()
        return ended

    def linger(self, start_s: float, least_s: float = LEAST_STEP_S) -> None:
        """Let time pass until a step has taken as long as it must.

        Args:
            start_s: Simulated time at which the step began [s].
            least_s: Simulated time that it takes at least [s].
        """
        self.rest_until(start_s + least_s)

    def rest_until(self, time_s: float) -> None:
        """Let time pass while no robot is busy, at most to the horizon [s]."""
        if not self.is_over:
            self.simulation.rest(min(time_s, self.horizon_s) - self.elapsed_s)
            self.conclude()

    def conclude(self) -> None:
        """Judge the episode if it has just ended. Call it after letting time pass.

        The robots stand still for :data:`STILL_S` before.
        """
        if not self.is_over or self._verdict is not None:
            return
        self._ended_s = self.simulation.time_s
        self.simulation.stand_still(STILL_S)
        self._verdict = self.succeeds(self.goal_progress)

    def stop(self) -> SkillResult:
        """End the episode and judge it."""
        self.stopped = True
        self.conclude()
        return SkillResult(Outcome.STOPPED, "The policy said stop.", 0.0)

    def snapshot(self) -> EpisodeSnapshot:
        """Return all that the rest of the episode depends on.

        Raises:
            InvalidActionError: A robot is busy, and not by :meth:`begin`.
        """
        if self.simulation.busy and self._quiet is not None:
            begun, now = tuple(self._begun), self.simulation.time_s
            return replace(self._quiet, begun=begun, until_s=now)
        return EpisodeSnapshot(
            self.instance,
            self.simulation.snapshot(),
            self.stages.state(),
            tuple(self.executed),
            self.stopped,
            self._ended_s,
            self._verdict,
            rule=None if self.rule is None else self.rule.state(),
        )

    def restore(self, snapshot: EpisodeSnapshot) -> None:
        """Go back to a snapshot of an episode of the same instance.

        Robots that were busy are so again. Their sub-tasks are carried out anew up
        to then, which takes as long as it took, and observers do not see it.

        Raises:
            InvalidConfigError: It was taken of another instance.
        """
        if snapshot.instance != self.instance:
            raise InvalidConfigError(
                f"The snapshot was taken of {snapshot.instance.key}, but this is an "
                f"episode of {self.instance.key}. Begin an episode of that instance."
            )
        self.simulation.restore(snapshot.simulation)
        self.stages.restore(snapshot.stages)
        self.executed = list(snapshot.executed)
        self.stopped = snapshot.stopped
        self._ended_s, self._verdict = snapshot.ended_s, snapshot.verdict
        self._quiet = None
        if self.rule is not None and snapshot.rule is not None:
            self.rule.restore(snapshot.rule)
        if snapshot.begun:
            self._catch_up(snapshot)

    def _catch_up(self, snapshot: EpisodeSnapshot) -> None:
        """Carry out anew all that had begun in a snapshot."""
        observers = self.simulation.observers
        kept = tuple(observers)
        observers[:] = [] if self.rule is None else [self.rule.look]
        try:
            for one in snapshot.begun:
                self._pass_until(one.start_s)
                self.begin(one.grounded, dict(one.leaving))
            self._pass_until(snapshot.until_s)
        finally:
            observers[:] = kept

    def _pass_until(self, time_s: float) -> None:
        while (
            self.simulation.busy and self.simulation.time_s < time_s - 0.5 * TIME_STEP_S
        ):
            self.advance(time_s)

    def info(self, goal_progress: float | None = None) -> dict[str, Any]:
        """Return the figures that every step and reset reports.

        Args:
            goal_progress: The present fraction of the goal, where that is known.
        """
        holds = self.goal_progress if goal_progress is None else goal_progress
        success = self.succeeds(holds)
        elapsed = self.elapsed_s
        return {
            "is_success": success,
            "success": success,
            "progress": self.progress,
            "goal_progress": holds,
            "stages": self.stages.record(),
            "elapsed_s": elapsed,
            "idle_s": {
                name: clock.idle_s(elapsed)
                for name, clock in self.simulation.clocks.items()
            },
            "failure": self.failure,
            "fallen": list(self.fallen),
            "thrown": list(self.thrown),
            **({} if self.rule is None else {"rule": self.rule.info()}),
            "instruction": self.instance.instructions["high_level"],
            "instance": self.instance.key,
        }


def _watch_rule(simulation: Simulation, goal: Goal) -> RuleWatch | None:
    """Watch the rule of a goal, if it has one; what breaks it ends all sub-tasks."""
    if goal.rule is None:
        return None
    parts = {(on.top, on.bottom): on for on in goal.placements}
    watch = RuleWatch(simulation.scene, goal.rule, parts)
    # None of these holds the simulation, which would be a circle.
    simulation.fault = lambda: watch.broken
    simulation.observers.append(watch.look)
    return watch
