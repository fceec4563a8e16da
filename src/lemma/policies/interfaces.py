"""Inputs and answers of policies; the interfaces of planners and grounders.

A decision is a pure function of a :class:`PolicyInput`, which holds all that was seen
and done since the episode began. Policies keep no state, so that many episodes can be
decided at once, in any order, and again from the middle. Evaluation makes a policy anew
for each kind of sentence, because all kinds are played on the same tables, unless the
policy says ``keeps_state = True``.

The truth is no part of it: an input is plain frozen data, copied out of the
simulation, and no attribute of it leads back. A policy that needs the truth is
an :class:`Oracle` by type, and results say so.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from lemma.core.robot_names import robot_number
from lemma.env.view import View
from lemma.tasks.language.bank import sub_instruction
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

if TYPE_CHECKING:
    from lemma.env.episode import Episode

TIMEOUT_S = 30.0
"""Time that a decision of somebody else's policy may take [s]."""


@dataclass(frozen=True, eq=False)
class PastStep:
    """One decision of the past."""

    view: View
    """The view before it."""
    subtask: SubTask
    outcome: str = "success"
    """How it went: a value of :class:`lemma.motion.outcome.Outcome`."""
    explanation: str = ""
    """Why it failed, in one sentence; empty if it did not."""


@dataclass(frozen=True, eq=False)
class PolicyInput:
    """All that a policy may know when it decides on the next sub-task."""

    instruction: str
    robots: tuple[str, ...]
    """How people name the robots, from the first to the last: ``"red robot"``."""
    view: View
    past: tuple[PastStep, ...] = ()
    """Decisions before this one, oldest first."""
    hands: tuple[str, ...] = ()
    """Hands of the robots, names in ``lemma.robots.hand.HANDS``; empty where all have
    the standard one."""

    def words_for(self, subtask: SubTask) -> str:
        """Return a sub-task of this scene as a sub-instruction.

        Raises:
            UnknownNameError: There is no such primitive or entity.
            InvalidConfigError: It names no cube where it needs one.
        """
        return sub_instruction(
            self.robots[robot_number(subtask.robot)] if subtask.robot else "",
            str(subtask.primitive),
            subtask.pick or None,
            subtask.place or None,
        )

    def with_past(self, past: tuple[PastStep, ...]) -> "PolicyInput":
        """Return the same input with another past."""
        return replace(self, past=past)


@dataclass(frozen=True, eq=False, kw_only=True)
class OracleInput(PolicyInput):
    """Input of an oracle, with the truth."""

    episode: "Episode" = field(repr=False)
    """The episode itself, with its simulation."""

    def without_truth(self) -> PolicyInput:
        """Return what anybody else is given."""
        return PolicyInput(
            self.instruction, self.robots, self.view, self.past, self.hands
        )


class Oracle:
    """Says that a planner, grounder or policy needs the truth: subclass it.

    Oracles are given :class:`OracleInput`, and results of policies with an oracle in
    them say ``"oracle": true``.
    """


class Composite:
    """A policy, planner or grounder that is made of others: a dataclass of them."""

    @property
    def parts(self) -> tuple[object, ...]:
        """Its parts."""
        return tuple(vars(self).values())


def is_oracle(part: object) -> bool:
    """Whether a policy or a part of one needs the truth, or something in it does."""
    if isinstance(part, Composite):
        return any(map(is_oracle, part.parts))
    return isinstance(part, Oracle)


def wants_cameras(part: object) -> bool:
    """Whether a policy looks at camera images, not at the map alone.

    It says so by an attribute: ``cameras = True``.
    """
    parts = part.parts if isinstance(part, Composite) else ()
    return getattr(part, "cameras", False) is True or any(map(wants_cameras, parts))


def keeps_state(part: object) -> bool:
    """Whether a policy remembers something of the episodes that it has played.

    It says so by an attribute: ``keeps_state = True``. It is then not made anew for
    each kind of sentence, and the lines of its result say so.
    """
    if isinstance(part, Composite):
        return any(map(keeps_state, part.parts))
    return getattr(part, "keeps_state", False) is True


def visible_to(part: object, inputs: Sequence[PolicyInput]) -> list[PolicyInput]:
    """Return inputs as a part of a policy may see them: the truth for oracles alone.

    A policy that passes inputs on to a part passes these.
    """
    if is_oracle(part):
        return list(inputs)
    return [
        one.without_truth() if isinstance(one, OracleInput) else one for one in inputs
    ]


@dataclass(frozen=True, slots=True)
class Effort:
    """Cost of a decision of a language model."""

    calls: int = 0
    """Requests, also those that were answered with nonsense or not at all."""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    invalid: tuple[str, ...] = ()
    """Kinds of the answers that were no sub-task, in order."""


@dataclass(frozen=True)
class Decision:
    """The next sub-task, or a reason for there being none."""

    subtask: SubTask
    """In symbols."""
    grounded: GroundedSubTask | None
    """With poses; None to stop, or where no pose was found."""
    explanation: str = ""
    """Why there is no pose, or any other remark; with a first decision to stop, why
    this team cannot do what is asked: it refuses."""
    failed: str = ""
    """A kind of fault where there is no decision, which costs this episode alone; then
    the sub-task is ``STOP``."""
    effort: Effort | None = None
    """Its cost, where that is counted."""

    @property
    def stops(self) -> bool:
        """Whether it says that the goal is reached."""
        return self.subtask.primitive is Primitive.STOP


@runtime_checkable
class Planner(Protocol):
    """Decides who does what with which object (high level)."""

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode; ``STOP`` when the goal is reached.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@runtime_checkable
class Proposer(Protocol):
    """A planner with more to say than a sub-task: what it took, or that it failed."""

    def propose(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode, without poses.

        Args:
            inputs: One per episode; at least one.
        """
        ...


def proposals(planner: Planner, inputs: Sequence[PolicyInput]) -> list[Decision]:
    """Return what a planner decides, with all that it has to say of it."""
    visible = visible_to(planner, inputs)
    if isinstance(planner, Proposer):
        return planner.propose(visible)
    return [Decision(subtask, None) for subtask in planner.plan(visible)]


@runtime_checkable
class Grounder(Protocol):
    """Decides where exactly (low level)."""

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with the gripper's poses; None where there are none.

        Args:
            inputs: One per episode; at least one.
            subtasks: One per episode, none of them ``STOP``.
        """
        ...


@runtime_checkable
class Policy(Protocol):
    """Decides both: a planner with a grounder, or a model of its own kind."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@dataclass(frozen=True, slots=True)
class Understanding:
    """The meaning of a sentence, to a policy that reads."""

    goal: GoalPairs
    """The likeliest (top, bottom) pairs, none if there is none."""
    certainty: float
    """How likely they are, or that the sentence is no order, in [0, 1]."""
    refusal: str = ""
    """Why it is no order, in a sentence; empty if it is one."""
    refuses: bool = True
    """Whether it can refuse; else what says what shall not be is not read."""
    other: GoalPairs = ()
    """The second likeliest pairs."""
    other_certainty: float = 0.0
    """How likely those are, in [0, 1]."""


@runtime_checkable
class Reader(Protocol):
    """A policy that can say what a sentence asks for, before it acts."""

    def understand(self, inputs: Sequence[PolicyInput]) -> list[Understanding]:
        """Return what each sentence asks for.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@dataclass(frozen=True, slots=True)
class SeenObject:
    """A thing that a policy perceived."""

    name: str
    """Name of the entity."""
    at: tuple[float, float]
    """Where, on the table [m]."""


@dataclass(frozen=True, slots=True)
class SeenRobot:
    """A robot that a policy perceived, by its number in a team."""

    at: tuple[float, float]
    """Where its base is [m]."""
    reach_m: tuple[float, float]
    """Radii between which the policy believes that it works [m]."""

    def margin_m(self, point: tuple[float, float]) -> float:
        """Return how far inside the reach a point is; negative outside [m]."""
        inner, outer = self.reach_m
        distance = math.dist(self.at, point)
        return min(distance - inner, outer - distance)


@dataclass(frozen=True, slots=True)
class Insight:
    """Why a policy decides as it does."""

    objects: tuple[SeenObject, ...]
    robots: tuple[SeenRobot, ...]
    goal: GoalPairs
    """The (top, bottom) pairs that it takes the sentence for."""
    options: tuple[tuple[SubTask, float], ...]
    """The likeliest sub-tasks, and how likely it holds each, in [0, 1]."""


@runtime_checkable
class Explainer(Protocol):
    """A policy that can say what it perceived, and what else it thought of."""

    def explain(self, inputs: Sequence[PolicyInput]) -> list[Insight]:
        """Return why each decision is what it is.

        Args:
            inputs: One per episode; at least one.
        """
        ...
