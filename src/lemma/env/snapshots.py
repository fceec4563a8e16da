"""Snapshots and watches of a simulation, time counters, and running sub-tasks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from lemma.core.poses import FloatArray
from lemma.motion.outcome import Outcome, SkillResult
from lemma.motion.reservations import WaitingTimes
from lemma.motion.rmpflow.workspace import ArmTarget
from lemma.motion.skills import Skill
from lemma.scene.build import TIME_STEP_S
from lemma.scene.coasting import CoastingState
from lemma.tasks.subtask import GroundedSubTask


class Watch(Protocol):
    """Follows a simulation, and looks at it less often than in every tick."""

    @property
    def due_ticks(self) -> int:
        """Number of servo ticks until it looks next, at least 1."""

    def look(self, ticks: int) -> None:
        """Count servo ticks that have passed, and look if it is due."""


@dataclass
class RobotClock:
    """Time counter of one robot."""

    busy_s: float = 0.0
    """Executing sub-tasks [s]."""

    def idle_s(self, elapsed_s: float) -> float:
        """Return the time spent waiting so far [s]."""
        return max(0.0, elapsed_s - self.busy_s)


@dataclass(frozen=True, slots=True)
class ArmSnapshot:
    """State of an arm's motion that is not in the physics."""

    reference: FloatArray
    """Joint angles and velocities that the servos follow, (2, 6) [rad, rad/s]."""
    goal: ArmTarget
    opening_m: float
    """Commanded opening of the gripper [m]."""
    busy_s: float
    """See :class:`.RobotClock` [s]."""


@dataclass(frozen=True, slots=True)
class SimulationSnapshot:
    """A simulation between two sub-tasks or control steps."""

    physics: FloatArray
    """The full integration state."""
    arms: dict[str, ArmSnapshot]
    coasting: CoastingState
    """How far each object has moved without a robot."""
    waiting: WaitingTimes
    """Time that each arm has waited for others."""


@dataclass(slots=True)
class Running:
    """A sub-task that is being executed."""

    subtask: GroundedSubTask
    skill: Skill
    start_s: float
    until_s: float
    fallen: tuple[str, ...]
    """Objects that had fallen off the table before it began."""
    looked_s: float = -math.inf
    """Simulated time at which the skill last looked at the world [s]."""
    partner: str = ""
    """The other robot of a joint sub-task."""
    leads: bool = True
    """Whether the sub-task was given to this robot; False for a partner."""
    result: SkillResult | None = None
    """How it ended, while its partner is still at work."""
    due: float = 1.0
    """Looks that it has not made yet; a slow robot's skill looks less often."""

    def looks(self, now_s: float, pace: float) -> bool:
        """Whether the skill looks at the world now; it does so once in a servo tick."""
        if self.looked_s == now_s:
            return False
        self.looked_s, due = now_s, self.due + pace
        self.due = due - 1.0 if due >= 1.0 else due
        return due >= 1.0


@dataclass(frozen=True, slots=True)
class Ended:
    """A sub-task that has ended."""

    subtask: GroundedSubTask
    result: SkillResult
    start_s: float
    """Simulated time at which it began [s]."""


def outcome_of(
    running: Running, partner: Running | None, now_s: float
) -> SkillResult | None:
    """Return how a sub-task went, for all of its robots; None if it goes on.

    Args:
        running: The sub-task of one robot.
        partner: The part of its partner in a joint sub-task; None for other sub-tasks.
        now_s: Present simulated time [s].
    """
    if partner is None:
        return running.result
    if running.result is None or partner.result is None:
        return None
    first, second = (running, partner) if running.leads else (partner, running)
    results = [one.result for one in (first, second) if one.result is not None]
    said = next((result for result in results if not result.ok), results[0])
    return SkillResult(said.outcome, said.explanation, now_s - first.start_s)


def broken_off(
    running: Running, now_s: float, thrown: Sequence[str], fault: str | None
) -> SkillResult | None:
    """Return how a sub-task ends that must not go on, None if it may.

    Args:
        running: The sub-task.
        now_s: Present simulated time [s].
        thrown: Objects that have been thrown.
        fault: Why the episode has failed otherwise.
    """
    took_s = now_s - running.start_s
    if fault is not None:
        return SkillResult(Outcome.RULE, fault, took_s)
    if thrown:
        said = f"Moved on without a robot: {', '.join(thrown)}."
        return SkillResult(Outcome.THROWN, said, took_s)
    if now_s >= running.until_s - 0.5 * TIME_STEP_S:
        said = f"The episode ended at {running.until_s:g} s."
        return SkillResult(Outcome.OUT_OF_TIME, said, took_s)
    return None


_FINAL = (Outcome.OUT_OF_TIME, Outcome.THROWN, Outcome.RULE)


def with_losses(result: SkillResult, fell: Sequence[str]) -> SkillResult:
    """Return a result that names the objects that fell off the table, if any did."""
    if not fell or result.outcome in _FINAL:
        return result
    explanation = "" if result.ok else f"{result.explanation} "
    explanation += f"The {' and the '.join(fell)} fell off the table."
    return SkillResult(Outcome.DROPPED, explanation, result.duration_s)
