"""Policies in other processes behind the interfaces of policies."""

from collections.abc import Sequence
from typing import Any, TypeVar

from lemma.policies.interfaces import Decision, PolicyInput
from lemma.serve.client.conversation import Conversation
from lemma.serve.protocol.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.serve.protocol.messages import METHODS, Decisions, Poses, SubTasks
from lemma.tasks.subtask import GroundedSubTask, SubTask

T = TypeVar("T")


class Remote:
    """A policy that is asked over a channel."""

    def __init__(self, conversation: Conversation) -> None:
        """Keep the connection."""
        self.conversation = conversation

    @property
    def about(self) -> dict[str, Any]:
        """What the policy says of itself."""
        return dict(self.conversation.welcome.policy)

    def close(self) -> None:
        """Hang up."""
        self.conversation.close()


class _Acts(Remote):
    """Decides on everything."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode.

        Raises:
            PolicyFailedError: It has none.
        """
        reply = self.conversation.decide("act", inputs, Decisions)
        return _counted(reply.decisions, "decisions", len(inputs))


class _Plans(Remote):
    """Decides in symbols."""

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode.

        Raises:
            PolicyFailedError: It has none.
        """
        reply = self.conversation.decide("plan", inputs, SubTasks)
        return _counted(reply.subtasks, "subtasks", len(inputs))


class _Grounds(Remote):
    """Decides on poses."""

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with poses; None where there are none.

        Raises:
            PolicyFailedError: It did not answer.
        """
        reply = self.conversation.decide("ground", inputs, Poses, subtasks)
        return _counted(reply.poses, "poses", len(inputs))


_PARTS: dict[str, type[Remote]] = dict(
    zip(METHODS, (_Acts, _Plans, _Grounds), strict=True)
)


def remote(conversation: Conversation) -> Remote:
    """Return the policy at the other end; it has the methods that it has there.

    Raises:
        ProtocolError: It has none.
    """
    offered = conversation.welcome.methods
    bases = tuple(_PARTS[name] for name in METHODS if name in offered)
    if not bases:
        raise ProtocolError(
            f"{conversation.where} offers {offered}, and none of {', '.join(METHODS)}."
        )
    made: Remote = type("RemotePolicy", bases, {})(conversation)
    return made


def _counted(answers: list[T], name: str, count: int) -> list[T]:
    if len(answers) != count:
        raise PolicyFailedError(
            FaultKind.MALFORMED,
            f"The policy answered {len(answers)} {name} to {count} inputs.",
        )
    return answers
