"""The client side of the policy protocol.

Inputs contain the whole past. To save bandwidth, both sides keep the views of the last
request on a connection, and refer to them by number. Requests do not depend on each
other, so a request can be sent again on a new connection, together with all its views.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count as counting
from typing import Any, Protocol, TypeVar

from lemma.core.errors import LemmaError
from lemma.env.view import View
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.together.interfaces import Orders, TeamInput
from lemma.serve import messages
from lemma.serve.arrays import ViewMessage
from lemma.serve.faults import (
    UNAVAILABLE,
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.messages import malformed
from lemma.tasks.subtask import GroundedSubTask, SubTask

_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 3.0
HELLO_S = 30.0
"""Time limit for the answer to the first message [s]."""
LARGEST_HELLO_BYTES = 1 << 20
"""Size limit of that answer, which is stored in results [bytes]."""
_SHOWN = 500

R = TypeVar("R", bound=messages.Reply)
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
            TimeoutError: No message came in time.
            OSError: The other side is gone.
        """
        ...

    def close(self) -> None:
        """Close the connection; never raises."""
        ...


@dataclass(frozen=True)
class ProtocolMode:
    """Time limits and retries of a client."""

    timeout_s: float
    """Time limit for one decision [s]; a batch of n has n times as long."""
    patience_s: float = 60.0
    """Time limit for a new connection after a lost one [s]."""
    first_patience_s: float = 10.0
    """Time limit for the first connection [s]; short, as the address may be wrong."""
    deaths: int = 3
    """Attempts of a request that ends the other side, before it counts as a fault of
    the policy."""


def keep_trying(connect: Callable[[], T], where: str, patience_s: float) -> T:
    """Return a connection; try again until a time limit.

    Args:
        connect: Function that opens the connection, or raises an OSError.
        where: The address, for error messages.
        patience_s: Time limit [s].

    Raises:
        PolicyUnreachableError: There was no connection in time.
    """
    end = time.monotonic() + patience_s
    pause_s = _PAUSE_S
    while True:
        try:
            return connect()
        except OSError as error:
            if time.monotonic() + pause_s > end:
                raise PolicyUnreachableError(
                    f"No answer from {where} for {patience_s:g} s: {error}. Start the "
                    "policy there (lemma serve, or its model server) and run the same "
                    "command again: finished episodes are kept."
                ) from error
        time.sleep(pause_s)
        pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)


class Conversation:
    """A client's connection to a policy in another process."""

    def __init__(
        self, where: str, connect: Callable[[], Channel], mode: ProtocolMode
    ) -> None:
        """Connect for the first time.

        Args:
            where: The address, for error messages.
            connect: Function that opens a channel, or raises an OSError.
            mode: Time limits and retries.

        Raises:
            PolicyUnreachableError: There was no connection in time.
            ProtocolError: The other side uses another protocol.
        """
        self.where = where
        self._connect = connect
        self.mode = mode
        self._channel: Channel | None = None
        self._numbers = counting()
        self._sent: dict[View, int] = {}
        self.welcome = self._open(mode.first_patience_s)

    def close(self) -> None:
        """Close the connection; the next request opens a new one."""
        if self._channel is not None:
            self._channel.close()
        self._channel = None
        self._sent = {}

    def decide(
        self,
        question: type[messages.Act] | type[messages.Together],
        inputs: Sequence[PolicyInput],
        wanted: type[R],
        **more: Any,
    ) -> R:
        """Send a request about episodes, and return the answer.

        Args:
            question: Class of the request: :class:`~lemma.serve.messages.Act`,
                ``Plan``, ``Ground`` or ``Together``.
            inputs: One per episode.
            wanted: Class of the answer to this request.
            more: Other fields of the request.

        Raises:
            PolicyFailedError: The policy raised, gave a malformed answer or none in
                time, or its process ended at each attempt.
            PolicyUnreachableError: The connection is lost and cannot be opened again.
            ProtocolError: The other side did not understand the request.
        """

        def make() -> messages.Request:
            return question(**self._referring(inputs), **more)

        return self._decide(make, len(inputs), wanted)

    def control(self, inputs: Sequence[messages.ControlMessage]) -> messages.Commands:
        """Send a request for motor commands, and return the answer.

        Args:
            inputs: One per episode.

        Raises:
            LemmaError: As :meth:`decide`.
        """
        request = messages.Control(inputs=list(inputs))
        return self._decide(lambda: request, len(inputs), messages.Commands)

    def _decide(
        self, make: Callable[[], messages.Request], count: int, wanted: type[R]
    ) -> R:
        """Return the answer to a request about ``count`` episodes."""
        allowed_s = self.mode.timeout_s * count
        for _ in range(self.mode.deaths):
            if self._channel is None:
                self._open(self.mode.patience_s)
            try:
                end = time.monotonic() + allowed_s
                request = make()
                return self._ask(request, wanted, end - time.monotonic())
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
            except LemmaError:
                # The other side may not have read all views.
                self._sent = {}
                raise
        raise PolicyFailedError(
            FaultKind.DIED, f"{self.where} ended whenever it was asked this: {last}."
        )

    def _referring(self, inputs: Sequence[PolicyInput]) -> dict[str, Any]:
        """Return the inputs and the new views of a request.

        Later requests assume that the other side has the views of this request only.
        """
        known, self._sent = self._sent, {}
        written, new = list[messages.InputMessage](), []
        for policy_input in inputs:
            own = policy_input.own_views if isinstance(policy_input, TeamInput) else {}
            seen = (
                *(step.view for step in policy_input.past),
                policy_input.view,
                *own.values(),
            )
            for view in seen:
                if view in self._sent:
                    continue
                if view not in known:
                    known[view] = next(self._numbers)
                    new.append(ViewMessage.of(known[view], view))
                self._sent[view] = known[view]
            past = [
                messages.StepMessage(
                    self._sent[step.view], step.subtask, step.outcome, step.explanation
                )
                for step in policy_input.past
            ]
            number, robots = self._sent[policy_input.view], list(policy_input.robots)
            hands = list(policy_input.hands)
            plain = (policy_input.instruction, robots, number, past, hands)
            if isinstance(policy_input, TeamInput):
                team_message = messages.TeamMessage(
                    *plain,
                    time_s=policy_input.time_s,
                    free=list(policy_input.free),
                    doing=dict(policy_input.doing),
                    messages=list(policy_input.messages),
                    own_views={name: self._sent[view] for name, view in own.items()},
                )
                written.append(team_message)
            else:
                written.append(messages.InputMessage(*plain))
        return {"inputs": written, "views": new}

    def _ask(self, request: messages.Request, wanted: type[R], timeout_s: float) -> R:
        """Send a request once, and return the answer.

        Raises:
            TimeoutError: No answer came in time.
            OSError: The other side is gone.
            PolicyFailedError: The policy raised or gave a malformed answer.
            PolicyUnreachableError: The policy's machine lacks memory, disk or files.
            ProtocolError: The other side did not understand the request.
        """
        assert self._channel is not None
        end = time.monotonic() + timeout_s
        self._channel.send(messages.encode(request))
        data = self._channel.receive(max(0.0, end - time.monotonic()))
        if isinstance(request, messages.Hello) and len(data) > LARGEST_HELLO_BYTES:
            raise ProtocolError(f"{self.where} answers 'hello' with {len(data)} bytes.")
        reply = messages.decode_reply(data)
        if isinstance(reply, messages.Error):
            if reply.kind in set(FaultKind):
                raise PolicyFailedError(FaultKind(reply.kind), reply.message)
            text = f"{self.where} refuses: {reply.message[:_SHOWN]}"
            if reply.kind == UNAVAILABLE:
                raise PolicyUnreachableError(text)
            raise ProtocolError(text)
        if not isinstance(reply, wanted):
            raise malformed(f"it is {type(reply).__name__}, not {wanted.__name__}")
        return reply

    def _open(self, patience_s: float) -> messages.Welcome:
        """Connect, and return the answer to the first message.

        Raises:
            PolicyUnreachableError: There was no connection in time.
            ProtocolError: The other side uses another protocol.
        """

        def connect() -> messages.Welcome:
            try:
                self._channel = self._connect()
                return self._greet()
            except (OSError, ProtocolError):
                self.close()
                raise

        return keep_trying(connect, self.where, patience_s)

    def _greet(self) -> messages.Welcome:
        version = messages.PROTOCOL
        try:
            hello = messages.Hello(protocol=version)
            welcome = self._ask(hello, messages.Welcome, HELLO_S)
        except PolicyFailedError as error:
            raise ProtocolError(
                f"{self.where} does not answer 'hello' like a policy: {error}"
            ) from error
        if welcome.protocol != version:
            raise ProtocolError(
                f"{self.where} uses version {welcome.protocol} of the policy protocol, "
                f"this client version {version}. Install the same version of "
                "lemma-bench on both sides."
            )
        return welcome


class Remote:
    """A policy in another process."""

    def __init__(self, conversation: Conversation) -> None:
        """Use a connection."""
        self.conversation = conversation
        self._episodes = counting()

    @property
    def about(self) -> dict[str, Any]:
        """The policy's description of itself."""
        return dict(self.conversation.welcome.policy)

    @property
    def keeps_state(self) -> bool:
        """Whether the policy declares that it keeps state across episodes."""
        return self.about.get("keeps_state") is True

    def close(self) -> None:
        """Close the connection."""
        self.conversation.close()


class _Acts(Remote):
    """A remote policy with ``act``, at skill or control level."""

    @property
    def control_options(self) -> dict[str, Any]:
        """Options of the environment in which it acts, at control level."""
        return dict(self.about.get("control_options", {}))

    def act(
        self, inputs: Sequence[PolicyInput] | Sequence[ControlInput]
    ) -> list[Decision] | list[Actions]:
        """Return the next decision of each episode, or its next actions.

        Raises:
            PolicyFailedError: The policy failed or gave no valid answer.
        """
        controls = [one for one in inputs if isinstance(one, ControlInput)]
        if controls:
            return self._control(controls)
        plain = [one for one in inputs if isinstance(one, PolicyInput)]
        reply = self.conversation.decide(messages.Act, plain, messages.Decisions)
        return _counted(reply.decisions, "decisions", len(inputs))

    def _control(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        # The server keeps the policy's memory; here it is the episode's number.
        asked = [
            messages.ControlMessage.of(
                control_input,
                next(self._episodes)
                if control_input.memory is None
                else control_input.memory,
            )
            for control_input in inputs
        ]
        answers = self.conversation.control(asked).actions
        rows = [array.read("actions") for array in answers]
        return [
            Actions(each, of.episode)
            for each, of in zip(
                _counted(rows, "actions", len(inputs)), asked, strict=True
            )
        ]


class _ActsTogether(Remote):
    """A remote policy that gives orders to the free robots of a team."""

    @property
    def asks_robots(self) -> bool:
        """Whether each robot decides alone, and needs its own view."""
        return self.about.get("asks_robots") is True

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return the orders of each episode.

        Raises:
            PolicyFailedError: The policy failed or gave no valid answer.
        """
        reply = self.conversation.decide(messages.Together, inputs, messages.AllOrders)
        return _counted(reply.orders, "orders", len(inputs))


class _Plans(Remote):
    """A remote planner: its decisions are sub-tasks without poses."""

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode.

        Raises:
            PolicyFailedError: The policy failed or gave no valid answer.
        """
        reply = self.conversation.decide(messages.Plan, inputs, messages.SubTasks)
        return _counted(reply.subtasks, "subtasks", len(inputs))


class _Grounds(Remote):
    """A remote grounder: it adds poses to sub-tasks."""

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with poses; None for one without.

        Raises:
            PolicyFailedError: The policy failed or gave no valid answer.
        """
        reply = self.conversation.decide(
            messages.Ground, inputs, messages.Poses, subtasks=list(subtasks)
        )
        return _counted(reply.poses, "poses", len(inputs))


_PARTS: dict[str, type[Remote]] = {
    "act": _Acts,
    "plan": _Plans,
    "ground": _Grounds,
    "act_together": _ActsTogether,
}


def remote(conversation: Conversation) -> Remote:
    """Return a remote policy with the methods of the policy on the other side.

    Raises:
        ProtocolError: That policy has none of the protocol's methods.
    """
    offered = conversation.welcome.methods
    bases = tuple(part for name, part in _PARTS.items() if name in offered)
    if not bases:
        conversation.close()
        raise ProtocolError(
            f"{conversation.where} offers {offered}, and none of {', '.join(_PARTS)}."
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
