"""Inputs and decisions of policies; the interfaces of planners and grounders.

A decision is a pure function of a :class:`PolicyInput`, which holds all observations
and decisions since the episode began. Policies are stateless, so episodes can be
decided as a batch, in any order, and resumed in the middle. All kinds of instructions
use the same scenes, so evaluation creates a new policy for each kind, unless the policy
has ``keeps_state = True``.

Inputs contain no privileged state: they are frozen data, copied out of the simulation,
without references to it. A policy that needs the true state is a subclass of
:class:`Oracle`, and results state that.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from lemma.core.registry import takes
from lemma.core.robot_names import robot_number
from lemma.env.view import View
from lemma.tasks.language.bank import sub_instruction
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

if TYPE_CHECKING:
    from lemma.env.episode import Episode

_SUCCESS = "success"
TIMEOUT_S = 30.0
"""Time limit for a decision of an external policy [s]."""


@dataclass(frozen=True, eq=False)
class PastStep:
    """A past decision with its outcome."""

    view: View
    """The view before the decision."""
    subtask: SubTask
    outcome: str = _SUCCESS
    """A value of :class:`lemma.motion.outcome.Outcome`."""
    explanation: str = ""
    """Why it failed, in one sentence; empty after success."""


@dataclass(frozen=True, eq=False)
class PolicyInput:
    """All inputs of a policy's decision on the next sub-task."""

    instruction: str
    robots: tuple[str, ...]
    """Names of the robots in instructions, in their order: ``"red robot"``."""
    view: View
    past: tuple[PastStep, ...] = ()
    """Decisions before this one, oldest first."""
    hands: tuple[str, ...] = ()
    """Hands of the robots, names in ``lemma.robots.hand.HANDS``; empty where all have
    the standard one."""

    @property
    def views(self) -> tuple[View, ...]:
        """The views of all decisions since the episode began, oldest first."""
        return (*(step.view for step in self.past), self.view)

    @property
    def failed(self) -> list[SubTask]:
        """Sub-tasks that failed since the last success, newest first."""
        recent = takewhile(lambda step: step.outcome != _SUCCESS, self.past[::-1])
        return [step.subtask for step in recent]

    def words_for(self, subtask: SubTask) -> str:
        """Return a sub-task of this scene as a sub-instruction.

        Raises:
            UnknownNameError: There is no such primitive or entity.
            InvalidConfigError: The sub-task lacks a cube that its primitive needs.
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
    """Input of an oracle, with the true state."""

    episode: "Episode" = field(repr=False)
    """The episode with its simulation."""

    def without_truth(self) -> PolicyInput:
        """Return the input without privileged state, as other policies get it."""
        return PolicyInput(
            self.instruction, self.robots, self.view, self.past, self.hands
        )


class Oracle:
    """Base class that marks a planner, grounder or policy as privileged.

    Oracles get an :class:`OracleInput`. Results of policies that are or contain an
    oracle have ``"oracle": true``.
    """


class Composite:
    """A policy, planner or grounder composed of others, a dataclass with its parts."""

    @property
    def parts(self) -> tuple[object, ...]:
        """The values of the dataclass's fields."""
        return tuple(vars(self).values())


def is_oracle(part: object) -> bool:
    """Return whether a policy or a part of one is, or contains, an oracle."""
    if isinstance(part, Composite):
        return any(map(is_oracle, part.parts))
    return isinstance(part, Oracle)


def wants_cameras(part: object) -> bool:
    """Return whether a policy needs camera images besides the map.

    Such a policy has the attribute ``cameras = True``.
    """
    parts = part.parts if isinstance(part, Composite) else ()
    return getattr(part, "cameras", False) is True or any(map(wants_cameras, parts))


def keeps_state(part: object) -> bool:
    """Return whether a policy keeps state from one episode to the next.

    Such a policy has the attribute ``keeps_state = True``. Evaluation then does not
    create a new one for each kind of instruction, and the lines of the result state it.
    """
    if isinstance(part, Composite):
        return any(map(keeps_state, part.parts))
    return getattr(part, "keeps_state", False) is True


def visible_to(part: object, inputs: Sequence[PolicyInput]) -> list[PolicyInput]:
    """Return inputs for a part of a policy, with privileged state only for oracles.

    A composed policy must filter the inputs of its parts with this function.
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
    """Number of requests, including those with an invalid answer or none."""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    invalid: tuple[str, ...] = ()
    """Kinds of the invalid answers, in order."""


@dataclass(frozen=True)
class Decision:
    """The next sub-task, or the reason why there is none."""

    subtask: SubTask
    """The symbolic sub-task."""
    grounded: GroundedSubTask | None
    """The sub-task with poses; None to stop, or if no pose was found."""
    explanation: str = ""
    """Why there is no pose, or another remark. If the first decision is to stop, it is
    a refusal: the reason why this team cannot do the task."""
    failed: str = ""
    """The kind of fault if the policy failed to decide; then the sub-task is ``STOP``,
    and only this episode fails."""
    effort: Effort | None = None
    """The cost of the decision, if it is counted."""

    @property
    def stops(self) -> bool:
        """Whether the decision is to stop."""
        return self.subtask.primitive is Primitive.STOP


@runtime_checkable
class Planner(Protocol):
    """High level: decides on the robot, the primitive and the objects."""

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode; ``STOP`` when the goal is reached.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@runtime_checkable
class Proposer(Protocol):
    """A planner that returns decisions with their cost and failures."""

    def propose(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode, without poses.

        Args:
            inputs: One per episode; at least one.
        """
        ...


def proposals(planner: Planner, inputs: Sequence[PolicyInput]) -> list[Decision]:
    """Return a planner's decisions, with cost and failures from a :class:`Proposer`."""
    visible = visible_to(planner, inputs)
    if isinstance(planner, Proposer):
        return planner.propose(visible)
    return [Decision(subtask, None) for subtask in planner.plan(visible)]


@runtime_checkable
class Grounder(Protocol):
    """Low level: decides on the poses of a sub-task."""

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with the gripper's poses; None if it finds none.

        Args:
            inputs: One per episode; at least one.
            subtasks: One per episode, none of them ``STOP``.
        """
        ...


@runtime_checkable
class Policy(Protocol):
    """Decides on sub-tasks with poses: a planner with a grounder, or one model."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@dataclass(frozen=True, slots=True)
class Understanding:
    """A policy's interpretation of an instruction."""

    goal: GoalPairs
    """The most likely (top, bottom) pairs; may be empty."""
    certainty: float
    """Probability of the goal, or of the refusal, in [0, 1]."""
    refusal: str = ""
    """Why the sentence is no order, in one sentence; empty if it is an order."""
    refuses: bool = True
    """Whether the policy can refuse; if not, it does not read negations."""
    other: GoalPairs = ()
    """The second most likely pairs."""
    other_certainty: float = 0.0
    """Probability of the second most likely pairs, in [0, 1]."""


@runtime_checkable
class Reader(Protocol):
    """A policy that returns the goal of an instruction before it acts."""

    def understand(self, inputs: Sequence[PolicyInput]) -> list[Understanding]:
        """Return the interpretation of each instruction.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@dataclass(frozen=True, slots=True)
class SeenObject:
    """An object that a policy perceived."""

    name: str
    """Name of the entity."""
    at: tuple[float, float]
    """World x, y [m]."""


@dataclass(frozen=True, slots=True)
class SeenRobot:
    """A robot that a policy perceived, by its number in a team."""

    at: tuple[float, float]
    """World x, y of its base [m]."""
    reach_m: tuple[float, float]
    """Smallest and largest radius of its reach, as the policy estimates it [m]."""

    def margin_m(self, point: tuple[float, float]) -> float:
        """Return the distance of a point from the border of the reach [m].

        It is negative outside of the reach.
        """
        inner, outer = self.reach_m
        distance = math.dist(self.at, point)
        return min(distance - inner, outer - distance)


@dataclass(frozen=True, slots=True)
class Insight:
    """A policy's perception, goal and options at a decision."""

    objects: tuple[SeenObject, ...]
    robots: tuple[SeenRobot, ...]
    goal: GoalPairs
    """The (top, bottom) pairs that it reads from the instruction."""
    options: tuple[tuple[SubTask, float], ...]
    """The most likely sub-tasks, with their probabilities in [0, 1]."""


@runtime_checkable
class Explainer(Protocol):
    """A policy that reports its perception and its alternatives."""

    def explain(self, inputs: Sequence[PolicyInput]) -> list[Insight]:
        """Return the insight into each decision.

        Args:
            inputs: One per episode; at least one.
        """
        ...


_VERBS = {Planner: ("plan", 1), Grounder: ("ground", 2), Policy: ("act", 1)}
"""The method of each interface, and its number of arguments."""


def can(part: Any, interface: type[Any]) -> bool:
    """Return whether an object has the method of an interface, with its arguments.

    ``isinstance`` compares names alone, but agents of other libraries have ``act``,
    too.
    """
    verb, arguments = _VERBS[interface]
    return takes(getattr(part, verb, None), arguments)
