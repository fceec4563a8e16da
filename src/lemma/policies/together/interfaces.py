"""Inputs and answers of policies that give orders to several robots at once.

A :class:`TeamPolicy` decides for the whole team, a :class:`RobotPolicy` for one robot
at a time. Both are asked whenever a robot is free: at the beginning, when an order has
ended or had its effect, and after a second in which nobody works. As everywhere, a
decision is a pure function of its input.
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
    """Work of a robot that has an order."""

    subtask: SubTask
    since_s: float
    """Simulated time at which it was given [s]."""
    waits_for: tuple[str, ...] = ()
    """Robots for whose effect or sector it waits now."""


@dataclass(frozen=True, slots=True)
class Message:
    """Words of one robot to all others."""

    robot: str
    text: str
    time_s: float = 0.0
    """Simulated time [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TeamInput(PolicyInput):
    """All that a policy may know when robots are free.

    ``view`` shows the present moment, with arms in motion. ``past`` holds the orders
    that have ended, in that order; the view of each is that of when it was given.
    """

    time_s: float
    """Simulated time [s]."""
    free: tuple[str, ...]
    """Robots that can be given an order."""
    doing: Mapping[str, Doing] = field(default_factory=dict)
    """Orders under way, by robot, oldest first."""
    messages: tuple[Message, ...] = ()
    """All messages of the episode so far, of a policy that is asked robot by robot."""
    own_views: Mapping[str, View] = field(default_factory=dict)
    """For such a policy, the view of each free robot: its own camera and joints."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TeamOracleInput(TeamInput, OracleInput):
    """Input of an oracle, with the truth."""

    team: "Team" = field(repr=False)
    """Orders under way, with their predicted effects."""

    def without_truth(self) -> TeamInput:
        """Return what anybody else is given."""
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
    """An answer: orders for some of the free robots; the others wait."""

    decisions: tuple[Decision, ...] = ()
    """At most one for each free robot, given in this order: each is carried out with
    the effects of those before in mind. ``stop`` is the team's: those at work finish,
    and the episode ends."""
    messages: tuple[Message, ...] = ()
    """Of robots to each other."""
    efforts: tuple[Effort, ...] = ()
    """Cost of further decisions, which gave no order."""


@runtime_checkable
class TeamPolicy(Protocol):
    """Decides for all free robots of a team. Subclass it, or write the method."""

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
    """All that one robot may know when it is free.

    ``view`` is of its own camera and joints: the map shows what that camera sees,
    ``joints`` is (1, 6). ``past`` holds its own orders.
    """

    robot: str
    """Which one it is."""
    time_s: float
    """Simulated time [s]."""
    inbox: tuple[Message, ...] = ()
    """All that the others have told it since the episode began, oldest first."""


@dataclass(frozen=True, slots=True)
class Choice:
    """An answer of one robot."""

    order: Decision | SubTask | None = None
    """Its own next order; None to wait. ``stop`` is the team's."""
    message: str = ""
    """To all others, up to :data:`LONGEST_MESSAGE` characters; empty for none."""


@runtime_checkable
class RobotPolicy(Protocol):
    """Decides for one robot. Subclass it, or write the method.

    Free robots are asked one after another, in the order of the team, so a message
    reaches those that are asked later at the same moment.
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
    """Return an answer of a :class:`TeamPolicy` as orders.

    Raises:
        TypeError: It is something else.
    """
    if isinstance(answer, Orders):
        return answer
    if not isinstance(answer, Sequence) or isinstance(answer, str):
        raise TypeError(f"orders are a {type(answer).__name__}, no list of decisions")
    return Orders(tuple(map(decision_of, answer)))


def decision_of(order: Decision | SubTask) -> Decision:
    """Return an order as a decision; anything else as it is."""
    return Decision(order, None) if isinstance(order, SubTask) else order
