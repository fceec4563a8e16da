"""What can be wrong with a policy."""

from enum import StrEnum

from lemma.core.errors import LemmaError


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
    """What it decided on made the physics unstable."""


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


class ProtocolError(LemmaError, RuntimeError):
    """The other side says something that the protocol does not know."""
