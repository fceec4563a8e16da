"""Parts of an episode's line: sub-tasks, and what robots do at the same time."""

from typing import Annotated

import msgspec
from msgspec import Meta


class Strict(msgspec.Struct, forbid_unknown_fields=True):
    """A part of a line: what is no field of it could be of any size."""


Names = Annotated[list[str], Meta(max_length=1000)]


class Symbols(Strict):
    """A sub-task without poses."""

    robot: str
    primitive: str
    pick: str
    place: str


class Poses(Strict):
    """A sub-task with poses, of x, y [m] and yaw [rad]."""

    robot: str
    primitive: str
    pick: tuple[float, float, float]
    place: tuple[float, float, float]


class OrderRecord(Symbols, kw_only=True):
    """An order of a team policy."""

    asked: int
    """How often the policy had been asked before."""
    poses: Poses | None


class MessageRecord(Strict):
    """A message of a robot."""

    robot: str
    text: Annotated[str, Meta(max_length=1000)]
    time_s: float


class PairRecord(Strict):
    """Record of an instance of a pair of which one cannot be done."""

    can: bool
    """Whether this team can do it."""
    refused: bool
    """Whether the policy stopped before anything was done."""
    explained: bool
    """Whether its reason names, of the things in the goal, exactly those that are out
    of reach."""
    reason: Annotated[str, Meta(max_length=2000)]
    """Its words as it refused; empty if it gave none."""


class Together(Strict):
    """Record of an episode in which robots act at the same time.

    Figures are of the strict episode.
    """

    expert_poses: bool
    """Whether the expert grounded the orders when they began."""
    asked: int
    """How often the policy was asked, in all."""
    orders: Annotated[list[OrderRecord], Meta(max_length=2000)]
    """All of the lenient episode, in the order in which they were given."""
    messages: Annotated[list[MessageRecord], Meta(max_length=20_000)]
    makespan_s: float
    oracle_s: float | None
    """Time of the executed oracle; None for instances without one."""
    schedule_score: float | None
    concurrency: float
    busy_s: dict[str, float]
    waiting_s: dict[str, float]
    thinking_s: dict[str, float]
    predecessor_s: dict[str, float]
    no_work_s: dict[str, float]
    parallel_s: float
    retreats: int
    deadlocks: int
    contact_s: float
    """Time in which two arms touched."""
