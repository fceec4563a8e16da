"""Records of the orders of a team, and of their results."""

from collections.abc import Mapping
from dataclasses import dataclass

from lemma.motion.outcome import SkillResult
from lemma.planning.grounding import GroundedOption
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.subtask import GroundedSubTask, SubTask


@dataclass(frozen=True, slots=True)
class Order:
    """A sub-task that a robot carries out, or waits to begin."""

    subtask: SubTask | None
    """Symbolic sub-task; None if only poses are known."""
    grounded: GroundedSubTask
    start_s: float
    """Simulated time at which it was given [s]."""
    option: GroundedOption | None = None
    """Grounded option with its predicted effect, if known."""
    before: SymbolicState | None = None
    """The state in which the option was grounded."""
    waits_for: frozenset[str] = frozenset()
    """Robots whose effects must come first; the order begins when the set is empty."""
    own_poses: bool = False
    """Whether the poses are the policy's, so that the effect may differ."""
    partner: str = ""
    """The other robot of a joint sub-task, which it takes as well."""


@dataclass(frozen=True, slots=True)
class Done:
    """An order that has ended."""

    robot: str
    subtask: SubTask | None
    grounded: GroundedSubTask | None
    """None where no poses were found."""
    result: SkillResult
    start_s: float
    """Simulated time at which it began or was refused [s]."""
    effect_s: float | None = None
    """Time at which its effect was first seen [s]; None if unchecked before the end."""
    partner: str = ""
    """The other robot of a joint sub-task."""


@dataclass(frozen=True, slots=True)
class TeamState:
    """The state of a team beside that of its episode; plain data."""

    orders: dict[str, Order]
    rests: dict[str, float]
    effects: dict[str, float]


def works_on(robot: str, orders: Mapping[str, Order]) -> str:
    """Return the robot with whose order a robot is busy; empty if it is free.

    That is the robot itself, or the one whose partner it is. A joint order that still
    waits has not taken its partner yet.

    Args:
        robot: Its name; may be empty.
        orders: All orders by robot.
    """
    if not robot or robot in orders:
        return robot
    takers = (
        name
        for name, order in orders.items()
        if order.partner == robot and not order.waits_for
    )
    return next(takers, "")
