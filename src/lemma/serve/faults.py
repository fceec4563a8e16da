"""Faults of policies, and errors that are not a policy's fault."""

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
"""Kind of an error message whose cause is not the policy."""
_MACHINE = frozenset(
    getattr(errno, name)
    for name in ("ENOSPC", "EDQUOT", "EIO", "EROFS", "EMFILE", "ENFILE", "ENOMEM")
    if hasattr(errno, name)
)
_NO_MEMORY = re.compile(r"(?i)can't allocate memory|out of memory|start new thread")
"""Messages of RuntimeErrors for a lack of memory or threads."""


class FaultKind(StrEnum):
    """Kinds of a policy's faults."""

    RAISED = "raised"
    """It raised an exception."""
    TIMEOUT = "timeout"
    """It did not answer in time."""
    DIED = "died"
    """Its process or connection ended at each attempt of a request."""
    MALFORMED = "malformed"
    """Its answer has a wrong type, shape or number of elements."""
    NOT_FINITE = "not_finite"
    """Its answer has a pose that is NaN or infinite, or far outside of the table."""
    UNKNOWN_NAME = "unknown_name"
    """It named a robot, a primitive or an entity that does not exist."""
    UNSTABLE = "unstable"
    """Its decision made the physics unstable."""


class PolicyFailedError(LemmaError, RuntimeError):
    """A policy in another process gave no valid decision.

    This is a fault of the policy, so the episodes of the request fail.
    """

    def __init__(self, kind: FaultKind, explanation: str) -> None:
        """Create the error.

        Args:
            kind: Kind of the fault.
            explanation: Details, as a sentence.
        """
        super().__init__(explanation)
        self.kind = kind

    def __reduce__(self) -> tuple[type["PolicyFailedError"], tuple[FaultKind, str]]:
        """Return class and arguments for pickling."""
        return type(self), (self.kind, str(self))


class PolicyUnreachableError(LemmaError, RuntimeError):
    """A policy in another process cannot be reached.

    This is not a fault of the policy, since it made no decision.
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
    """Return the error that ends the run if the policy is not at fault; else None.

    The policy is not at fault for errors about files, disks, weights, rendering and
    memory.
    """
    if isinstance(error, _TROUBLE):
        return error
    # torch has its own errors for a lack of memory on a GPU or the machine.
    memory = (
        isinstance(error, MemoryError)
        or type(error).__name__ == "OutOfMemoryError"
        or (isinstance(error, RuntimeError) and _NO_MEMORY.search(str(error)))
    )
    if memory or (isinstance(error, OSError) and error.errno in _MACHINE):
        return PolicyUnreachableError(
            f"The policy could not decide: {type(error).__name__}: "
            f"{str(error).rstrip('.')}. This is a problem of the machine, not a fault "
            "of the policy. Free disk space, memory or files; the same command then "
            "continues."
        )
    # A policy may have wrapped such an error in another one.
    return None if error.__cause__ is None else trouble_of(error.__cause__)


class ProtocolError(LemmaError, RuntimeError):
    """The other side violates the protocol."""
