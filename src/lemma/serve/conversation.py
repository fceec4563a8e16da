"""The side of a conversation that asks a policy in another process.

Inputs hold the whole past, but a view is not sent twice in a row: both sides keep the
views of the last request on a connection, and refer to them by number. Requests do not
depend on each other, so one may be sent again on a new connection, where the policy
knows no views.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count as counting
from typing import Any, Protocol, TypeVar

from lemma.env.view import View
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.serve.faults import (
    UNAVAILABLE,
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.messages import (
    METHODS,
    PROTOCOL,
    Act,
    Commands,
    Control,
    ControlMessage,
    Decisions,
    Error,
    Ground,
    Hello,
    InputMessage,
    Plan,
    Poses,
    Reply,
    Request,
    StepMessage,
    SubTasks,
    ViewMessage,
    Welcome,
    decode_reply,
    encode,
    malformed,
)
from lemma.tasks.subtask import GroundedSubTask, SubTask

_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 3.0
HELLO_S = 30.0
"""For the answer to the first message [s]."""
LARGEST_HELLO_BYTES = 1 << 20
"""Size limit of that answer, which results hold."""
_SHOWN = 500

R = TypeVar("R", bound=Reply)
T = TypeVar("T")


class Channel(Protocol):
    """Carries messages to the other side and back."""

    def send(self, message: bytes) -> None:
        """Send a message.

        Raises:
            OSError: The other side is gone.
        """
        ...

    def receive(self, timeout_s: float) -> bytes | str:
        """Return the next message.

        Raises:
            TimeoutError: There is none in time.
            OSError: The other side is gone.
        """
        ...

    def close(self) -> None:
        """Close the connection; never raises."""
        ...


@dataclass(frozen=True)
class ProtocolMode:
    """How patient the asking side is."""

    timeout_s: float
    """For one decision; a batch of n has n times as long."""
    patience_s: float = 60.0
    """How long it tries to connect again."""
    first_patience_s: float = 10.0
    """How long it tries to connect at first, so that a wrong address shows soon."""
    deaths: int = 3
    """How often the other side may die of one request before that is its fault."""


def keep_trying(connect: Callable[[], T], where: str, patience_s: float) -> T:
    """Return a connection, trying again for a while.

    Args:
        connect: Opens it; raises OSError where nobody answers.
        where: The address, for messages to people.
        patience_s: How long to try [s].

    Raises:
        PolicyUnreachableError: Nobody answers.
    """
    end = time.monotonic() + patience_s
    pause_s = _PAUSE_S
    while True:
        try:
            return connect()
        except OSError as error:
            if time.monotonic() + pause_s > end:
                raise PolicyUnreachableError(
                    f"Nobody answers at {where}: {error}. Tried for {patience_s:g} s. "
                    "Start the policy there (lemma serve, or its model server) and run "
                    "the same command again: finished episodes are kept."
                ) from error
        time.sleep(pause_s)
        pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)


class Conversation:
    """Asks a policy in another process."""

    def __init__(
        self, where: str, connect: Callable[[], Channel], mode: ProtocolMode
    ) -> None:
        """Connect for the first time.

        Args:
            where: The address, for messages to people.
            connect: Opens a channel; raises OSError where nobody answers.
            mode: How patient to be.

        Raises:
            PolicyUnreachableError: Nobody answers.
            ProtocolError: The other side speaks another protocol.
        """
        self.where = where
        self._connect = connect
        self.mode = mode
        self._channel: Channel | None = None
        self._numbers = counting()
        self._sent: dict[View, int] = {}
        self.welcome = self._open(mode.first_patience_s)

    def close(self) -> None:
        """Hang up; the next question connects again."""
        if self._channel is not None:
            self._channel.close()
        self._channel = None
        self._sent = {}

    def decide(
        self,
        question: type[Act],
        inputs: Sequence[PolicyInput],
        wanted: type[R],
        **more: Any,
    ) -> R:
        """Return the answer to a question about episodes.

        Args:
            question: :class:`~lemma.serve.messages.Act`, ``Plan`` or ``Ground``.
            inputs: One per episode.
            wanted: The answer that belongs to the question.
            more: Other fields of the question.

        Raises:
            PolicyFailedError: The policy raised, gave a malformed answer or none in
                time, or died of the question.
            PolicyUnreachableError: Nobody answers any more.
            ProtocolError: The other side did not understand.
        """
        return self._decide(
            lambda: self._request(question, inputs, more), len(inputs), wanted
        )

    def control(self, inputs: Sequence[ControlMessage], wanted: type[R]) -> R:
        """Return the answer to a question about motor commands.

        Args:
            inputs: One per episode.
            wanted: The answer that belongs to it.

        Raises:
            LemmaError: As :meth:`decide`.
        """
        request = Control(inputs=list(inputs))
        return self._decide(lambda: (request, {}), len(inputs), wanted)

    def _decide(
        self,
        make: Callable[[], tuple[Request, dict[View, int]]],
        count: int,
        wanted: type[R],
    ) -> R:
        """Return the answer to a request about so many episodes."""
        allowed_s = self.mode.timeout_s * count
        for _ in range(self.mode.deaths):
            if self._channel is None:
                self._open(self.mode.patience_s)
            try:
                end = time.monotonic() + allowed_s
                request, views = make()
                reply = self._ask(request, wanted, end - time.monotonic())
            except TimeoutError as error:
                self.close()
                raise PolicyFailedError(
                    FaultKind.TIMEOUT,
                    f"The policy did not decide within {allowed_s:g} s "
                    f"({count} decisions of {self.mode.timeout_s:g} s).",
                ) from error
            except OSError as error:
                self.close()
                last = error
            except (PolicyFailedError, ProtocolError):
                # The other side may not have read all views.
                self._sent = {}
                raise
            else:
                self._sent = views
                return reply
        raise PolicyFailedError(
            FaultKind.DIED, f"{self.where} ended whenever it was asked this: {last}."
        )

    def _request(
        self,
        question: type[Act],
        inputs: Sequence[PolicyInput],
        more: Mapping[str, Any],
    ) -> tuple[Request, dict[View, int]]:
        """Return a request, and the number of every view that it refers to."""
        views: dict[View, int] = {}
        for given in inputs:
            for view in (*(step.view for step in given.past), given.view):
                if view not in views:
                    known = self._sent.get(view)
                    views[view] = next(self._numbers) if known is None else known
        new = [
            ViewMessage.of(number, view)
            for view, number in views.items()
            if view not in self._sent
        ]
        written = [_input(given, views) for given in inputs]
        return question(inputs=written, views=new, **more), views

    def _ask(self, request: Request, wanted: type[R], timeout_s: float) -> R:
        """Return the answer to a message.

        Raises:
            TimeoutError: There is none in time.
            OSError: The other side is gone.
            PolicyFailedError: The policy raised or gave a malformed answer.
            PolicyUnreachableError: The policy's machine is in trouble.
            ProtocolError: The other side did not understand.
        """
        assert self._channel is not None
        end = time.monotonic() + timeout_s
        self._channel.send(encode(request))
        data = self._channel.receive(max(0.0, end - time.monotonic()))
        if isinstance(request, Hello) and len(data) > LARGEST_HELLO_BYTES:
            raise ProtocolError(f"{self.where} answers 'hello' with {len(data)} bytes.")
        reply = decode_reply(data)
        if isinstance(reply, Error):
            if reply.kind in set(FaultKind):
                raise PolicyFailedError(FaultKind(reply.kind), reply.message)
            text = f"{self.where} refuses: {reply.message[:_SHOWN]}"
            if reply.kind == UNAVAILABLE:
                raise PolicyUnreachableError(text)
            raise ProtocolError(text)
        if not isinstance(reply, wanted):
            raise malformed(f"it is {type(reply).__name__}, not {wanted.__name__}")
        return reply

    def _open(self, patience_s: float) -> Welcome:
        """Connect, and return the answer to the first message.

        Raises:
            PolicyUnreachableError: Nobody answers.
            ProtocolError: The other side speaks another protocol.
        """

        def connect() -> Welcome:
            try:
                self._channel = self._connect()
                return self._greet()
            except (OSError, ProtocolError):
                self.close()
                raise

        return keep_trying(connect, self.where, patience_s)

    def _greet(self) -> Welcome:
        try:
            welcome = self._ask(Hello(protocol=PROTOCOL), Welcome, HELLO_S)
        except PolicyFailedError as error:
            raise ProtocolError(
                f"{self.where} does not answer 'hello' as a policy does: {error}"
            ) from error
        if welcome.protocol != PROTOCOL:
            raise ProtocolError(
                f"{self.where} speaks version {welcome.protocol} of the policy "
                f"protocol, and this is version {PROTOCOL}. Install the same version "
                "of lemma-bench on both sides."
            )
        return welcome


def _input(given: PolicyInput, views: Mapping[View, int]) -> InputMessage:
    past = [
        StepMessage(views[step.view], step.subtask, step.outcome, step.explanation)
        for step in given.past
    ]
    return InputMessage(given.instruction, list(given.robots), views[given.view], past)


class Remote:
    """A policy in another process."""

    def __init__(self, conversation: Conversation) -> None:
        """Keep the connection."""
        self.conversation = conversation
        self._episodes = counting()

    @property
    def about(self) -> dict[str, Any]:
        """The description that the policy gives of itself."""
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
        reply = self.conversation.decide(Act, plain, Decisions)
        return _counted(reply.decisions, "decisions", len(inputs))

    def _control(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        # The memory stays with the policy; here it is the number of the episode.
        episodes = [
            next(self._episodes) if given.memory is None else given.memory
            for given in inputs
        ]
        asked = [
            ControlMessage.of(*each) for each in zip(inputs, episodes, strict=True)
        ]
        reply = self.conversation.control(asked, Commands)
        rows = [array.read("actions") for array in reply.actions]
        answers = _counted(rows, "actions", len(inputs))
        return [Actions(*each) for each in zip(answers, episodes, strict=True)]


class _Plans(Remote):
    """Decides in symbols."""

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode.

        Raises:
            PolicyFailedError: It has none.
        """
        reply = self.conversation.decide(Plan, inputs, SubTasks)
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
        asked = list(subtasks)
        reply = self.conversation.decide(Ground, inputs, Poses, subtasks=asked)
        return _counted(reply.poses, "poses", len(inputs))


_PARTS: dict[str, type[Remote]] = dict(
    zip(METHODS, (_Acts, _Plans, _Grounds), strict=True)
)


def remote(conversation: Conversation) -> Remote:
    """Return the policy at the other end, with the methods that it has there.

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
