"""The status of an episode: plain data that its thread writes and pages read."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from lemma.evaluation.run.rollout import Rollout
from lemma.tasks.language.bank import phrase
from lemma.tasks.language.template import GoalPairs
from lemma.viz.recording import Line


@dataclass(frozen=True, slots=True)
class Reading:
    """The reading of a sentence."""

    pairs: GoalPairs | None
    """(top, bottom) pairs that shall hold; None where the policy does not say."""
    note: str = ""
    """A remark, in a sentence."""
    acts: bool = True
    """Whether the policy should act on it."""


class Phase(StrEnum):
    """State of an episode."""

    SETTING = "Setting the table"
    READY = "Ready"
    LOADING = "Loading the policy"
    READING = "Reading the sentence"
    DECIDING = "Deciding"
    ACTING = "Acting"
    LED = "You lead"
    SOLVED = "Done"
    FOLLOWED = "Done, as I understood it"
    """The goal that was understood holds; whether it was meant is not known."""
    FAILED = "Not done"
    ENDED = "Ended"
    BROKEN = "Stopped"


ENDS = (Phase.SOLVED, Phase.FOLLOWED, Phase.FAILED, Phase.ENDED, Phase.BROKEN)
"""Phases that do not end by themselves."""


@dataclass(frozen=True, slots=True)
class Status:
    """Status of an episode, in words."""

    phase: Phase = Phase.SETTING
    said: str = ""
    """The sentence."""
    policy: str = ""
    note: str = ""
    """Reason or result."""
    reading: Reading | None = None
    lines: tuple[Line, ...] = ()


def say_goal(pairs: GoalPairs) -> str:
    """Return a goal in words: ``"the red cube on the white pad"``."""
    return " and ".join(
        f"the {phrase(top)} on the {phrase(bottom)}" for top, bottom in pairs
    )


class StatusBoard:
    """Status of an episode; written by its thread, read by any."""

    def __init__(self, policy: str) -> None:
        """Begin with a table that is being set.

        Args:
            policy: Name of the policy.
        """
        self.status = Status(policy=policy)
        """A new object whenever something changes."""

    def tell(self, phase: Phase | None = None, **changes: Any) -> None:
        """Change some of it.

        Args:
            phase: The new phase; as before if None.
            changes: Fields of :class:`Status`.
        """
        if phase is not None:
            changes["phase"] = phase
        self.status = replace(self.status, **changes)

    def begin(self, phase: Phase, words: str, start_s: float) -> None:
        """Add a line that runs.

        Args:
            phase: The new phase.
            words: The line.
            start_s: Simulated time [s].
        """
        self.tell(phase, lines=(*self.status.lines, Line(words, start_s)))

    def end(self, end_s: float, outcome: str) -> None:
        """End the line that runs, if one does.

        Args:
            end_s: Simulated time [s].
            outcome: How it ended.
        """
        done, running = self._split()
        ended = (replace(line, end_s=end_s, outcome=outcome) for line in running)
        self.tell(lines=(*done, *ended))

    def insert(self, line: Line) -> None:
        """Add a line that has ended, before the one that runs."""
        done, running = self._split()
        self.tell(lines=(*done, line, *running))

    def replace_running(self, line: Line) -> None:
        """Put a line that has ended in the place of the one that runs."""
        done, _ = self._split()
        self.tell(lines=(*done, line))

    def _split(self) -> tuple[tuple[Line, ...], tuple[Line, ...]]:
        """Return the lines that have ended, and the one that runs if one does."""
        lines = self.status.lines
        running = tuple(line for line in lines if line.end_s is None)
        return tuple(line for line in lines if line.end_s is not None), running

    def conclude(self, rollout: Rollout, *, known: bool) -> None:
        """Report the end of an episode.

        Args:
            rollout: The episode.
            known: Whether the sentence asks for the goal of its instance; if not, only
                the reading can be judged.
        """
        took = f"{rollout.episode.elapsed_s:.1f} s"
        understood = self.status.reading.pairs if self.status.reading else None
        if rollout.fault is not None:
            done, _ = self._split()
            note = f"The policy failed: {rollout.fault.explanation}"
            self.tell(Phase.BROKEN, note=note, lines=done)
            return
        if not known and understood is None:
            self.tell(Phase.ENDED, note=f"after {took}: nobody can judge it")
            return
        asked = rollout.asked_holds
        verdict = rollout.verdict()
        holds = verdict.success if asked is None else asked
        what = (verdict.failure or "goal_not_reached").replace("_", " ")
        note = f"after {took}" if holds else f"after {took}: {what}"
        if holds and rollout.protective_stop is not None:
            note += ", though a robot was asked for what it cannot do"
        goal = rollout.instance.goal.pairs
        if known and understood is not None and set(understood) != set(goal):
            note += f". The sentence asks for {say_goal(goal)}"
        if holds and not known and understood:
            note = f"{say_goal(understood)}, {note}"
        good = Phase.SOLVED if known else Phase.FOLLOWED
        self.tell(good if holds else Phase.FAILED, note=note)
