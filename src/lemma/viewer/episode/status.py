"""The request of an episode by the page, and the status reported by its thread."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.spec import ORACLE
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.language.bank import say_pair
from lemma.tasks.language.template import KINDS, RELATIONAL, GoalPairs
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import FREE_SPLIT, SUITE, load_instance
from lemma.viz.recording import Line

TOGETHER = "oracle together"
"""Name of the expert that acts with all robots at the same time."""
KNOWING = ORACLE, TOGETHER
"""Policies that have the goal and understand only sentences of the benchmark."""
OWN_WORDS = "your own words"
SAYINGS = (*KINDS, RELATIONAL, OWN_WORDS)
"""Kinds of sentences: those of the instance, or a visitor's own."""
LONGEST = 300
"""Largest number of characters of a sentence."""


@dataclass(frozen=True, slots=True)
class EpisodeRequest:
    """An instance, a sentence, and the policy that follows it."""

    task: str = SUITE[0]
    split: str = "test"
    index: int = 0
    saying: str = SAYINGS[0]
    """One of :data:`SAYINGS`."""
    text: str = ""
    """The visitor's own sentence, with ``saying = OWN_WORDS``."""
    policy: str = ORACLE
    own: Instance | None = None
    """A user-defined instance; None for that of the task's list."""

    def __post_init__(self) -> None:
        """Check the split and the length of the sentence.

        Raises:
            UnknownNameError: No such split.
            InvalidConfigError: The sentence is too long.
        """
        known("split", self.split, (*SPLITS, FREE_SPLIT))
        if len(self.text) > LONGEST:
            raise InvalidConfigError(
                f"The sentence has {len(self.text)} characters. Use at most {LONGEST}."
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
    """The goal's pairs (top, bottom); None if the policy does not report them."""
    note: str = ""
    """A remark, as a sentence."""
    acts: bool = True
    """Whether the policy should act on it."""
    choices: tuple[GoalPairs, ...] = ()
    """Readings of similar probability, from which the visitor chooses."""


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
    """The goal of the policy's reading holds; the reading may be wrong."""
    FAILED = "Not done"
    ENDED = "Ended"
    BROKEN = "Stopped"


ENDS = (Phase.SOLVED, Phase.FOLLOWED, Phase.FAILED, Phase.ENDED, Phase.BROKEN)
"""Final phases."""


@dataclass(frozen=True, slots=True)
class Status:
    """Status of an episode, as text."""

    phase: Phase = Phase.SETTING
    said: str = ""
    """The visitor's sentence."""
    note: str = ""
    """Reason or result of the phase."""
    reading: Reading | None = None
    lines: tuple[Line, ...] = ()
    trained: str = ""
    """A remark on the policy's weights, as a sentence."""


def say_goal(pairs: GoalPairs) -> str:
    """Return a goal as text: ``"the red cube on the white pad"``."""
    return " and ".join(say_pair(top, bottom) for top, bottom in pairs)


@dataclass(frozen=True, slots=True)
class Moved:
    """The result of a visitor's request to move an object."""

    problem: str = ""
    """Why the object could not be moved; empty if it was moved."""


class StatusBoard:
    """Status of an episode; its thread writes it, any thread may read it."""

    def __init__(self) -> None:
        """Begin in the phase ``SETTING``."""
        self.status = Status()
        """The status; every change creates a new object."""

    def tell(self, phase: Phase | None = None, **changes: Any) -> None:
        """Change fields of the status.

        Args:
            phase: The new phase; None to keep it.
            changes: Fields of :class:`Status`.
        """
        if phase is not None:
            changes["phase"] = phase
        self.status = replace(self.status, **changes)

    def begin(
        self, phase: Phase, words: str, start_s: float, subtask: SubTask | None = None
    ) -> None:
        """Add a running line.

        Args:
            phase: The new phase.
            words: Text of the line.
            start_s: Simulated time [s].
            subtask: The sub-task; None for another event.
        """
        line = Line(words, start_s, subtask=subtask)
        self.tell(phase, lines=(*self.status.lines, line))

    def end(self, end_s: float, outcome: str) -> None:
        """End the running line, if there is one.

        Args:
            end_s: Simulated time [s].
            outcome: Its outcome, as text.
        """
        ended = (replace(line, end_s=end_s, outcome=outcome) for line in self._running)
        self.tell(lines=(*self._done, *ended))

    def insert(self, line: Line) -> None:
        """Insert a finished line before the running one."""
        self.tell(lines=(*self._done, line, *self._running))

    def replace_running(self, line: Line) -> None:
        """Replace the running line with a finished one."""
        self.tell(lines=(*self._done, line))

    def replace_robots(self, line: Line) -> None:
        """Replace the running line of a robot with a finished one."""
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
            known: Whether the sentence has the goal of the instance. Otherwise only the
                goal of the reading can be judged.
        """
        took = f"{rollout.episode.elapsed_s:.1f} s"
        understood = self.status.reading.pairs if self.status.reading else None
        if rollout.fault is not None:
            note = f"The policy failed: {rollout.fault.explanation}"
            self.tell(Phase.BROKEN, note=note, lines=self._done)
            return
        if not known and understood is None:
            self.tell(Phase.ENDED, note=f"after {took}; success is not judged")
            return
        asked = rollout.asked_holds
        verdict = rollout.verdict()
        holds = verdict.success if asked is None else asked
        what = (verdict.failure or "goal_not_reached").replace("_", " ")
        note = f"after {took}" if holds else f"after {took}: {what}"
        if holds and rollout.protective_stop is not None:
            note += ", although a robot got a sub-task that it cannot do"
        goal = rollout.instance.goal.pairs
        if known and understood is not None and set(understood) != set(goal):
            note += f". The sentence asks for {say_goal(goal)}"
        if holds and not known and understood:
            note = f"{say_goal(understood)}, {note}"
        good = Phase.SOLVED if known else Phase.FOLLOWED
        self.tell(good if holds else Phase.FAILED, note=note)
