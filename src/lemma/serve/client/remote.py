"""Policies in other processes behind the interfaces of policies."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from lemma.policies.interfaces import Decision, PolicyInput
from lemma.serve.client.conversation import Conversation
from lemma.serve.protocol.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.serve.protocol.messages import (
    METHODS,
    Message,
    decision_from_message,
    grounded_from_message,
    subtask_from_message,
)
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
        return dict(self.conversation.hello.get("policy", {}))

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
        reply = self.conversation.decide("act", inputs)
        return _answers(reply, "decisions", len(inputs), decision_from_message)


class _Plans(Remote):
    """Decides in symbols."""

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode.

        Raises:
            PolicyFailedError: It has none.
        """
        reply = self.conversation.decide("plan", inputs)
        return _answers(reply, "subtasks", len(inputs), subtask_from_message)


class _Grounds(Remote):
    """Decides on poses."""

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with poses; None where there are none.

        Raises:
            PolicyFailedError: It did not answer.
        """
        reply = self.conversation.decide("ground", inputs, subtasks)
        return _answers(reply, "poses", len(inputs), _grounded_or_none)


_PARTS: dict[str, type[Remote]] = dict(
    zip(METHODS, (_Acts, _Plans, _Grounds), strict=True)
)


def remote(conversation: Conversation) -> Remote:
    """Return the policy at the other end; it has the methods that it has there.

    Raises:
        ProtocolError: It has none.
    """
    offered = conversation.hello["methods"]
    bases = tuple(_PARTS[name] for name in METHODS if name in offered)
    if not bases:
        raise ProtocolError(
            f"{conversation.where} offers {offered}, and none of {', '.join(METHODS)}."
        )
    made: Remote = type("RemotePolicy", bases, {})(conversation)
    return made


def _grounded_or_none(data: object) -> GroundedSubTask | None:
    return None if data is None else grounded_from_message(data)


def _answers(
    reply: Message, name: str, count: int, read: Callable[[object], T]
) -> list[T]:
    answers = reply.get(name)
    if not isinstance(answers, list | tuple) or len(answers) != count:
        found = len(answers) if isinstance(answers, list | tuple) else "no list"
        raise PolicyFailedError(
            FaultKind.MALFORMED,
            f"The policy answered {found} {name} to {count} inputs.",
        )
    return [read(answer) for answer in answers]
