"""Policies in other processes behind the interfaces of policies."""

from collections.abc import Sequence
from itertools import count
from typing import Any, TypeVar

from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.serve.client.conversation import Conversation
from lemma.serve.protocol.control import written
from lemma.serve.protocol.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.serve.protocol.messages import (
    METHODS,
    Commands,
    Decisions,
    Poses,
    SubTasks,
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
        return dict(self.conversation.welcome.policy)

    @property
    def keeps_state(self) -> bool:
        """Whether it says that it remembers other episodes."""
        return self.about.get("keeps_state") is True

    def close(self) -> None:
        """Hang up."""
        self.conversation.close()


class _Acts(Remote):
    """Decides on everything, or on motor commands."""

    def __init__(self, conversation: Conversation) -> None:
        """Keep the connection."""
        super().__init__(conversation)
        self._episodes = count()

    @property
    def control_options(self) -> dict[str, Any]:
        """In which environment it acts, at control level."""
        return dict(self.about.get("control_options", {}))

    def act(
        self, inputs: Sequence[PolicyInput] | Sequence[ControlInput]
    ) -> list[Decision] | list[Actions]:
        """Return the next decision of each episode, or its next actions.

        Raises:
            PolicyFailedError: It has none.
        """
        controls = [given for given in inputs if isinstance(given, ControlInput)]
        if controls:
            return self._control(controls)
        plain = [given for given in inputs if isinstance(given, PolicyInput)]
        return self._act(plain)

    def _control(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        # What it remembers stays where it is: here its number is remembered.
        episodes = [
            next(self._episodes) if given.memory is None else given.memory
            for given in inputs
        ]
        asked = [written(*each) for each in zip(inputs, episodes, strict=True)]
        reply = self.conversation.control(asked, Commands)
        rows = [array.read_any("actions") for array in reply.actions]
        answers = _counted(rows, "actions", len(inputs))
        return [Actions(*each) for each in zip(answers, episodes, strict=True)]

    def _act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
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
        conversation.close()
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
