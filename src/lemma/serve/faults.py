"""Faults of policies, and trouble that is no fault of theirs."""

import errno
import re
from enum import StrEnum

from lemma.core.errors import (
    CapacityError,
    DatasetError,
    LemmaError,
    RenderingError,
    WeightsError,
    WorkerError,
)
from lemma.policies.planners.chat import PlannerUnavailableError

UNAVAILABLE = "unavailable"
"""Kind of an error message that says nothing about the policy."""
_MACHINE = frozenset(
    getattr(errno, name)
    for name in ("ENOSPC", "EDQUOT", "EIO", "EROFS", "EMFILE", "ENFILE", "ENOMEM")
    if hasattr(errno, name)
)
_NO_MEMORY = re.compile(r"(?i)can't allocate memory|out of memory|start new thread")
"""Messages of plain RuntimeErrors where memory, or room for threads, is missing."""


class FaultKind(StrEnum):
    """The ways in which a policy can fail to decide."""

    RAISED = "raised"
    """It raised an exception."""
    TIMEOUT = "timeout"
    """It did not answer in time."""
    DIED = "died"
    """Its process or its connection ended whenever it was asked this."""
    MALFORMED = "malformed"
    """It answered something of another type, shape or number."""
    NOT_FINITE = "not_finite"
    """It answered a pose that is not a number, or that lies beyond every table."""
    UNKNOWN_NAME = "unknown_name"
    """It named a robot, a primitive or an entity that does not exist."""
    UNSTABLE = "unstable"
    """Its decision made the physics unstable."""


class PolicyFailedError(LemmaError, RuntimeError):
    """A policy in another process did not decide; asked again, others may fare better.

    A fault of the policy: it costs the episodes that it was asked about.
    """

    def __init__(self, kind: FaultKind, explanation: str) -> None:
        """Keep what happened.

        Args:
            kind: In one word.
            explanation: In one sentence.
        """
        super().__init__(explanation)
        self.kind = kind

    def __reduce__(self) -> tuple[type["PolicyFailedError"], tuple[FaultKind, str]]:
        """Return how another process builds it again."""
        return type(self), (self.kind, str(self))


class PolicyUnreachableError(LemmaError, RuntimeError):
    """Nobody answers where a policy should be.

    No fault of the policy: nothing is known about what it would have decided.
    """


_TROUBLE = (
    PolicyUnreachableError,
    PlannerUnavailableError,
    CapacityError,
    DatasetError,
    RenderingError,
    WeightsError,
    WorkerError,
)


def trouble_of(error: BaseException) -> LemmaError | None:
    """Return what ends the run if an error is no fault of the policy; else None.

    So are errors about files, disks, weights, pictures and memory: nothing is known
    about what the policy would have decided.
    """
    if isinstance(error, _TROUBLE):
        return error
    # torch raises errors of its own where a GPU or the machine has no memory left.
    memory = (
        isinstance(error, MemoryError)
        or type(error).__name__ == "OutOfMemoryError"
        or (isinstance(error, RuntimeError) and _NO_MEMORY.search(str(error)))
    )
    if memory or (isinstance(error, OSError) and error.errno in _MACHINE):
        return PolicyUnreachableError(
            f"The policy could not decide: {type(error).__name__}: "
            f"{str(error).rstrip('.')}. That is trouble of the machine, and no fault "
            "of the policy. Free disk space, memory or files; the same command then "
            "goes on."
        )
    # A policy may have wrapped it in an error of its own.
    return None if error.__cause__ is None else trouble_of(error.__cause__)


class ProtocolError(LemmaError, RuntimeError):
    """The other side says something that the protocol does not know."""
