"""Inputs and outputs of policies that give orders to several robots at once.

A :class:`TeamPolicy` decides for the whole team, a :class:`RobotPolicy` for one robot
at a time. Both are called whenever a robot is free: at the beginning, when an order has
ended or had its effect, and after a second without a working robot. As for other
policies, a decision is a pure function of its input.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from lemma.env.view import View
from lemma.policies.interfaces import (
    Decision,
    Effort,
    OracleInput,
    PolicyInput,
)
from lemma.tasks.subtask import SubTask

if TYPE_CHECKING:
    from lemma.env.team.orders import Team

LONGEST_MESSAGE = 200
"""Longest message of one robot to the others, in characters."""


@dataclass(frozen=True, slots=True)
class Doing:
    """The active order of a robot."""

    subtask: SubTask
    since_s: float
    """Simulated time of the order [s]."""
    waits_for: tuple[str, ...] = ()
    """Robots whose effect or sector it is waiting for."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message of one robot to all others."""

    robot: str
    text: str
    time_s: float = 0.0
    """Simulated time [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TeamInput(PolicyInput):
    """All inputs of a team policy's decision when robots are free.

    ``view`` is the present view, with arms in motion. ``past`` holds the ended orders,
    by the time of their end; the view of each is from the time when it was given.
    """

    time_s: float
    """Simulated time [s]."""
    free: tuple[str, ...]
    """Robots that can get an order."""
    doing: Mapping[str, Doing] = field(default_factory=dict)
    """Active orders by robot, oldest first."""
    messages: tuple[Message, ...] = ()
    """For a :class:`RobotPolicy`, all messages of the episode so far."""
    own_views: Mapping[str, View] = field(default_factory=dict)
    """For a :class:`RobotPolicy`, the view of each free robot: its camera and
    joints."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TeamOracleInput(TeamInput, OracleInput):
    """Input of an oracle, with the true state."""

    team: "Team" = field(repr=False)
    """Active orders, with their predicted effects."""

    def without_truth(self) -> TeamInput:
        """Return the input without privileged state, as other policies get it."""
        return TeamInput(
            self.instruction,
            self.robots,
            self.view,
            self.past,
            self.hands,
            time_s=self.time_s,
            free=self.free,
            doing=self.doing,
            messages=self.messages,
            own_views=self.own_views,
        )


@dataclass(frozen=True, slots=True)
class Orders:
    """Output of a team policy: orders for some of the free robots; the others wait."""

    decisions: tuple[Decision, ...] = ()
    """At most one for each free robot. Each takes the effects of those before it into
    account. ``stop`` is for the team: working robots finish, and the episode ends."""
    messages: tuple[Message, ...] = ()
    """Messages of robots to each other."""
    efforts: tuple[Effort, ...] = ()
    """Cost of further decisions, without an order."""


@runtime_checkable
class TeamPolicy(Protocol):
    """Decides for all free robots of a team. Subclass it, or write the method.

    A policy with the attribute ``symbolic = True`` never gives poses, so its name needs
    a grounder, such as ``+oracle``.
    """

    def act_together(
        self, inputs: Sequence[TeamInput]
    ) -> Sequence[Orders | Sequence[Decision | SubTask]]:
        """Return orders for some of the free robots of each episode; none to wait.

        Args:
            inputs: One per episode; at least one.

        Returns:
            For each episode a list of decisions with poses; or of sub-tasks, if the
            expert adds the poses (``+oracle``, ``level="plan"``).
        """
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotInput(PolicyInput):
    """All inputs of one robot's decision when it is free.

    ``view`` is from its own camera and joints: the map shows the cells in the camera's
    view, and ``joints`` is (1, 6). ``past`` holds its own orders.
    """

    robot: str
    """Name of the robot."""
    time_s: float
    """Simulated time [s]."""
    inbox: tuple[Message, ...] = ()
    """All messages of the others since the episode began, oldest first."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Output of a :class:`RobotPolicy` for one robot."""

    order: Decision | SubTask | None = None
    """Its own next order; None to wait. ``stop`` is for the team."""
    message: str = ""
    """To all others, up to :data:`LONGEST_MESSAGE` characters; empty for none."""


@runtime_checkable
class RobotPolicy(Protocol):
    """Decides for one robot. Subclass it, or write the method.

    It is called for one free robot after another, in the order of the team, so a
    message reaches the robots that decide later at the same time.
    """

    def act_alone(
        self, inputs: Sequence[RobotInput]
    ) -> Sequence[Choice | Decision | SubTask | None]:
        """Return the choice of a robot in each episode.

        Args:
            inputs: One per episode; at least one.
        """
        ...


def orders_of(answer: "Orders | Sequence[Decision | SubTask]") -> Orders:
    """Return the output of a :class:`TeamPolicy` as orders.

    Raises:
        TypeError: The output has another type.
    """
    if isinstance(answer, Orders):
        return answer
    if not isinstance(answer, Sequence) or isinstance(answer, str):
        raise TypeError(f"orders are a {type(answer).__name__}, no list of decisions")
    return Orders(tuple(map(decision_of, answer)))


def decision_of(order: Decision | SubTask) -> Decision:
    """Return a sub-task as a decision; other values unchanged."""
    return Decision(order, None) if isinstance(order, SubTask) else order
