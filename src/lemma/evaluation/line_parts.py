"""Parts of an episode's line: sub-tasks, and records of robots that act together."""

from typing import Annotated

import msgspec
from msgspec import Meta


class Strict(msgspec.Struct, forbid_unknown_fields=True):
    """A part of a line; unknown fields are errors, since their size is not bounded."""


Names = Annotated[list[str], Meta(max_length=1000)]


class Symbols(Strict):
    """A sub-task without poses."""

    robot: str
    primitive: str
    pick: str
    place: str


class Poses(Strict):
    """A sub-task with poses: x, y [m], yaw [rad] in the world frame."""

    robot: str
    primitive: str
    pick: tuple[float, float, float]
    place: tuple[float, float, float]


class OrderRecord(Symbols, kw_only=True):
    """An order of a team policy."""

    asked: int
    """Number of the policy's decisions before the order."""
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

    Times and scores are of the strict episode.
    """

    expert_poses: bool
    """Whether the expert grounded the orders when they began."""
    asked: int
    """Total number of the policy's decisions."""
    orders: Annotated[list[OrderRecord], Meta(max_length=2000)]
    """All orders of the lenient episode, oldest first."""
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
    """Time with contact between arms [s]."""
