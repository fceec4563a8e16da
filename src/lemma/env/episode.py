"""One instance being executed: sub-tasks so far, time, success."""

from dataclasses import dataclass
from typing import Any

from lemma.core.arguments import real
from lemma.core.errors import InvalidConfigError, ResetNeededError
from lemma.env.simulation import HORIZON_S, TICK_S, Simulation, SimulationSnapshot
from lemma.motion.outcome import Outcome, SkillResult
from lemma.scene.build import TIME_STEP_S
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask

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
class EpisodeSnapshot:
    """An episode between two sub-tasks or control steps; plain data, can be pickled."""

    instance: Instance
    simulation: SimulationSnapshot
    executed: tuple[ExecutedSubTask, ...]
    stopped: bool
    ended_s: float | None
    """Simulated time at which it ended [s]; None while it goes on."""
    verdict: bool | None
    """Whether it succeeded; None before that was judged."""


class Episode:
    """An executed instance, whoever decides what to do.

    When it ends, by ``stop`` or at the horizon, its robots stand still for
    :data:`STILL_S`; then it succeeds if the whole goal holds and nothing is held. That
    time is the judge's: ``elapsed_s`` does not count it. Before the end the same
    question is answered for the present moment.
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
        self.executed: list[ExecutedSubTask] = []
        self.stopped = False
        self._ended_s: float | None = None
        self._verdict: bool | None = None

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
        """Whether somebody said ``stop`` or the time is up."""
        return self.stopped or self.out_of_time

    @property
    def progress(self) -> float:
        """Fraction of the goal that holds now, in [0, 1]."""
        return self.instance.goal.progress(self.simulation.scene)

    @property
    def fallen(self) -> tuple[str, ...]:
        """Names of the objects that have fallen off the table: they are lost."""
        return self.simulation.scene.fallen

    @property
    def is_success(self) -> bool:
        """Whether it succeeded; before its end, whether it would if nothing changed."""
        return self.succeeds(self.progress)

    def succeeds(self, progress: float) -> bool:
        """Return :attr:`is_success` for the present progress, where that is known."""
        if self._verdict is not None:
            return self._verdict
        return progress == 1.0 and not self.simulation.held()

    @property
    def failure(self) -> str | None:
        """Why the episode failed: an outcome, or ``"goal_not_reached"``; else None.

        None as well while the episode is not over.
        """
        if not self.is_over or self.is_success:
            return None
        if self.out_of_time:
            return str(Outcome.OUT_OF_TIME)
        failed = [done.result.outcome for done in self.executed if not done.result.ok]
        return str(failed[-1]) if failed else "goal_not_reached"

    def execute(self, grounded: GroundedSubTask) -> SkillResult:
        """Execute one grounded sub-task.

        Raises:
            ResetNeededError: The episode is over.
            UnknownNameError: There is no such robot in this scene.
        """
        if self.is_over:
            raise ResetNeededError(
                f"The episode {self.instance.key} is over. Reset before you act again."
            )
        start = self.elapsed_s
        result = self.simulation.execute(grounded, until_s=self.horizon_s)
        self.executed.append(ExecutedSubTask(grounded, result, start))
        self.conclude()
        return result

    def linger(self, start_s: float, least_s: float = LEAST_STEP_S) -> None:
        """Let time pass until a step has taken as long as it must.

        Args:
            start_s: Simulated time at which the step began [s].
            least_s: Simulated time that it takes at least [s].
        """
        if not self.is_over:
            end_s = min(start_s + least_s, self.horizon_s)
            self.simulation.rest(end_s - self.elapsed_s)
            self.conclude()

    def conclude(self) -> None:
        """Judge the episode if it has just ended. Call it after letting time pass.

        The robots stand still for :data:`STILL_S` before.
        """
        if not self.is_over or self._verdict is not None:
            return
        self._ended_s = self.simulation.time_s
        self.simulation.stand_still(STILL_S)
        self._verdict = self.succeeds(self.progress)

    def stop(self) -> SkillResult:
        """End the episode and judge it."""
        self.stopped = True
        self.conclude()
        return SkillResult(Outcome.STOPPED, "The policy said stop.", 0.0)

    def snapshot(self) -> EpisodeSnapshot:
        """Return all that the rest of the episode depends on."""
        return EpisodeSnapshot(
            self.instance,
            self.simulation.snapshot(),
            tuple(self.executed),
            self.stopped,
            self._ended_s,
            self._verdict,
        )

    def restore(self, snapshot: EpisodeSnapshot) -> None:
        """Go back to a snapshot of an episode of the same instance.

        Raises:
            InvalidConfigError: It was taken of another instance.
        """
        if snapshot.instance != self.instance:
            raise InvalidConfigError(
                f"The snapshot was taken of {snapshot.instance.key}, but this is an "
                f"episode of {self.instance.key}. Begin an episode of that instance."
            )
        self.simulation.restore(snapshot.simulation)
        self.executed = list(snapshot.executed)
        self.stopped = snapshot.stopped
        self._ended_s, self._verdict = snapshot.ended_s, snapshot.verdict

    def info(self, progress: float | None = None) -> dict[str, Any]:
        """Return the figures that every step and reset reports.

        Args:
            progress: The present progress, where that is known.
        """
        if progress is None:
            progress = self.progress
        success = self.succeeds(progress)
        elapsed = self.elapsed_s
        return {
            "is_success": success,
            "success": success,
            "progress": progress,
            "elapsed_s": elapsed,
            "idle_s": {
                name: clock.idle_s(elapsed)
                for name, clock in self.simulation.clocks.items()
            },
            "failure": self.failure,
            "fallen": list(self.fallen),
            "instruction": self.instance.instructions["high_level"],
            "instance": self.instance.key,
        }
