"""The request of an episode, from the page, and its status, from its thread."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.spec import ORACLE
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.language.bank import say_pair
from lemma.tasks.language.template import KINDS, GoalPairs
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import FREE_SPLIT, SUITE, load_instance
from lemma.viz.recording import Line

TOGETHER = "oracle together"
"""Name of the expert with all robots at work at the same time."""
KNOWING = ORACLE, TOGETHER
"""Names of those that know the goal, and read the sentences of the benchmark alone."""
OWN_WORDS = "your own words"
SAYINGS = (*KINDS, OWN_WORDS)
"""Kinds of sentences: those of the instance, or any."""
LONGEST = 300
"""Characters of a sentence that are read."""


@dataclass(frozen=True, slots=True)
class EpisodeRequest:
    """An instance, a sentence, and the policy that follows it."""

    task: str = SUITE[0]
    split: str = "test"
    index: int = 0
    saying: str = SAYINGS[0]
    """One of :data:`SAYINGS`."""
    text: str = ""
    """A sentence in own words."""
    policy: str = ORACLE
    own: Instance | None = None
    """An own instance, instead of that of the task's list."""

    def __post_init__(self) -> None:
        """Check the split and the length of the sentence.

        Raises:
            UnknownNameError: No such split.
            InvalidConfigError: The sentence is too long.
        """
        splits = (*SPLITS, FREE_SPLIT)
        if self.split not in splits:
            raise UnknownNameError("split", self.split, splits)
        if len(self.text) > LONGEST:
            raise InvalidConfigError(
                f"The sentence has {len(self.text)} characters; say it in {LONGEST}."
            )

    def instance(self) -> Instance:
        """Return the instance.

        Raises:
            LemmaError: There is no such instance.
        """
        return self.own or load_instance(self.task, self.split, self.index)


@dataclass(frozen=True, slots=True)
class Reading:
    """The reading of a sentence."""

    pairs: GoalPairs | None
    """(top, bottom) pairs that shall hold; None where the policy does not say."""
    note: str = ""
    """A remark, in a sentence."""
    acts: bool = True
    """Whether the policy should act on it."""
    choices: tuple[GoalPairs, ...] = ()
    """Readings that are near each other, about which the visitor is asked."""


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
    note: str = ""
    """Reason or result."""
    reading: Reading | None = None
    lines: tuple[Line, ...] = ()
    trained: str = ""
    """A remark on the policy's weights, in a sentence."""


def say_goal(pairs: GoalPairs) -> str:
    """Return a goal in words: ``"the red cube on the white pad"``."""
    return " and ".join(say_pair(top, bottom) for top, bottom in pairs)


@dataclass(frozen=True, slots=True)
class Moved:
    """The result of a visitor's wish to lay an object elsewhere."""

    problem: str = ""
    """Why it could not be moved; empty if it was."""


class StatusBoard:
    """Status of an episode; written by its thread, read by any."""

    def __init__(self) -> None:
        """Begin with a table that is being set."""
        self.status = Status()
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

    def begin(
        self, phase: Phase, words: str, start_s: float, subtask: SubTask | None = None
    ) -> None:
        """Add a line that runs.

        Args:
            phase: The new phase.
            words: The line.
            start_s: Simulated time [s].
            subtask: None where it is none.
        """
        line = Line(words, start_s, subtask=subtask)
        self.tell(phase, lines=(*self.status.lines, line))

    def end(self, end_s: float, outcome: str) -> None:
        """End the line that runs, if one does.

        Args:
            end_s: Simulated time [s].
            outcome: How it ended.
        """
        ended = (replace(line, end_s=end_s, outcome=outcome) for line in self._running)
        self.tell(lines=(*self._done, *ended))

    def insert(self, line: Line) -> None:
        """Add a line that has ended, before the one that runs."""
        self.tell(lines=(*self._done, line, *self._running))

    def replace_running(self, line: Line) -> None:
        """Put a line that has ended in the place of the one that runs."""
        self.tell(lines=(*self._done, line))

    def replace_robots(self, line: Line) -> None:
        """Put a line that has ended in the place of the running one of its robot."""
        robot = line.subtask.robot if line.subtask else ""
        self.tell(
            lines=tuple(
                line
                if old.end_s is None and old.subtask and old.subtask.robot == robot
                else old
                for old in self.status.lines
            )
        )

    @property
    def _done(self) -> tuple[Line, ...]:
        return tuple(line for line in self.status.lines if line.end_s is not None)

    @property
    def _running(self) -> tuple[Line, ...]:
        return tuple(line for line in self.status.lines if line.end_s is None)

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
            note = f"The policy failed: {rollout.fault.explanation}"
            self.tell(Phase.BROKEN, note=note, lines=self._done)
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
