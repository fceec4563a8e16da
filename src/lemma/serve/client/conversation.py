"""The side of a conversation that asks: what was sent, what is asked, what went wrong.

Inputs hold the whole past, but a view is not sent twice in a row: both sides keep the
views of the last request on a connection, and know them by number. Requests are pure,
so one may be asked again on a new connection, where nothing is known.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count as counting
from typing import Any, Protocol, TypeVar

from lemma.env.view import View
from lemma.policies.interfaces import PolicyInput
from lemma.serve.protocol.faults import (
    UNAVAILABLE,
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.protocol.messages import (
    PROTOCOL,
    Act,
    Control,
    ControlMessage,
    Error,
    Ground,
    Hello,
    InputMessage,
    Plan,
    Reply,
    Request,
    StepMessage,
    ViewMessage,
    Welcome,
    decode_reply,
    encode,
    malformed,
)
from lemma.tasks.subtask import SubTask

_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 3.0
_HELLO_S = 30.0

R = TypeVar("R", bound=Reply)


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
        """Break off; never raises."""
        ...


@dataclass(frozen=True)
class ProtocolMode:
    """How patient the asking side is."""

    timeout_s: float
    """For one decision; a batch has as many times this."""
    patience_s: float = 60.0
    """How long it tries to connect again."""
    first_patience_s: float = 10.0
    """How long it tries to connect at first: a wrong address shows soon."""
    deaths: int = 3
    """How often the other side may die of one request before that is its fault."""


class Conversation:
    """Asks a policy in another process."""

    def __init__(
        self, where: str, connect: Callable[[], Channel], mode: ProtocolMode
    ) -> None:
        """Connect for the first time.

        Args:
            where: What is asked, for messages to people.
            connect: Opens a channel; raises OSError where nobody answers.
            mode: How patient to be.

        Raises:
            PolicyUnreachableError: Nobody answers.
            ProtocolError: Somebody answers who speaks something else.
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
        method: str,
        inputs: Sequence[PolicyInput],
        wanted: type[R],
        subtasks: Sequence[SubTask] = (),
    ) -> R:
        """Return the answer to a question about episodes.

        Args:
            method: ``"act"``, ``"plan"`` or ``"ground"``.
            inputs: One per episode.
            wanted: The answer that belongs to the method.
            subtasks: One per episode, to ground them.

        Raises:
            PolicyFailedError: It raised, answered nonsense, did not answer in time, or
                died of it.
            PolicyUnreachableError: Nobody answers any more.
            ProtocolError: The other side did not understand.
        """
        return self._decide(
            lambda: self._request(method, inputs, subtasks), len(inputs), wanted
        )

    def control(self, inputs: Sequence[ControlMessage], wanted: type[R]) -> R:
        """Return the answer to a question about motor commands.

        Args:
            inputs: One per episode.
            wanted: The answer that belongs to it.

        Raises:
            PolicyFailedError: As :meth:`decide`.
            PolicyUnreachableError: Nobody answers any more.
            ProtocolError: The other side did not understand.
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
                # Who knows how far the other side read.
                self._sent = {}
                raise
            else:
                self._sent = views
                return reply
        raise PolicyFailedError(
            FaultKind.DIED, f"{self.where} ended whenever it was asked this: {last}."
        )

    def _request(
        self, method: str, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> tuple[Request, dict[View, int]]:
        """Return a request, and the number of every view that it refers to."""
        views: dict[View, int] = {}
        for given in inputs:
            for view in (*(step.view for step in given.past), given.view):
                if view not in views:
                    known = self._sent.get(view)
                    views[view] = next(self._numbers) if known is None else known
        told: dict[str, Any] = {
            "inputs": [_input(given, views) for given in inputs],
            "views": [
                ViewMessage.of(number, view)
                for view, number in views.items()
                if view not in self._sent
            ],
        }
        if method == "ground":
            return Ground(subtasks=list(subtasks), **told), views
        return (Act if method == "act" else Plan)(**told), views

    def _ask(self, request: Request, wanted: type[R], timeout_s: float) -> R:
        """Return the answer to a message.

        Raises:
            TimeoutError: There is none in time.
            OSError: The other side is gone.
            PolicyFailedError: The policy raised or answered nonsense.
            ProtocolError: The other side did not understand.
        """
        assert self._channel is not None
        end = time.monotonic() + timeout_s
        self._channel.send(encode(request))
        reply = decode_reply(self._channel.receive(max(0.0, end - time.monotonic())))
        if isinstance(reply, Error):
            if reply.kind == UNAVAILABLE:
                raise PolicyUnreachableError(f"{self.where}: {reply.message}")
            if reply.kind in set(FaultKind):
                raise PolicyFailedError(FaultKind(reply.kind), reply.message)
            raise ProtocolError(f"{self.where} refuses: {reply.message}")
        if not isinstance(reply, wanted):
            raise malformed(f"it is {type(reply).__name__}, not {wanted.__name__}")
        return reply

    def _open(self, patience_s: float) -> Welcome:
        """Connect, trying again for a while.

        Raises:
            PolicyUnreachableError: Nobody answers.
            ProtocolError: Somebody answers who speaks something else.
        """
        end = time.monotonic() + patience_s
        pause_s = _PAUSE_S
        while True:
            try:
                self._channel = self._connect()
                return self._greet()
            except OSError as error:
                self.close()
                if time.monotonic() + pause_s > end:
                    raise PolicyUnreachableError(
                        f"Nobody answers at {self.where}: {error}. Tried for "
                        f"{patience_s:g} s. Start the policy there (lemma serve) and "
                        "run the same command again: what was finished is kept."
                    ) from error
            except ProtocolError:
                self.close()
                raise
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    def _greet(self) -> Welcome:
        try:
            welcome = self._ask(Hello(protocol=PROTOCOL), Welcome, _HELLO_S)
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
