"""The side of a conversation that asks: what was told, what is asked, what went wrong.

Inputs hold the whole past, but a view is sent only once: it is known by its identity,
which :class:`lemma.policies.interfaces.PastStep` keeps. Requests are pure, so the same
one may be asked again on a new connection, to which everything is told anew.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol
from weakref import WeakKeyDictionary, finalize

from lemma.env.view import View
from lemma.policies.interfaces import PolicyInput
from lemma.serve.protocol.faults import (
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.protocol.messages import (
    PROTOCOL,
    Message,
    entries,
    subtask_to_message,
    view_to_message,
)
from lemma.tasks.subtask import SubTask

_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 3.0
_MISSES = 4
_HELLO_S = 30.0


class Channel(Protocol):
    """Carries messages to the other side and back."""

    def send(self, message: Message) -> None:
        """Send a message.

        Raises:
            OSError: The other side is gone.
        """
        ...

    def receive(self, timeout_s: float) -> Message:
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


@dataclass
class _Episode:
    """What was told of an episode on a connection."""

    number: int
    connection: int = -1
    views: WeakKeyDictionary[View, int] = field(default_factory=WeakKeyDictionary)
    named: int = 0
    sent: set[int] = field(default_factory=set)

    def name(self, view: View) -> int:
        """Return the number of a view, which may be new."""
        if view not in self.views:
            self.views[view] = self.named
            self.named += 1
        return self.views[view]


class Conversation:
    """Asks a policy in another process."""

    def __init__(
        self, where: str, connect: Callable[[], Channel], manners: ProtocolMode
    ) -> None:
        """Connect for the first time.

        Args:
            where: What is asked, for messages to people.
            connect: Opens a channel; raises OSError where nobody answers.
            manners: How patient to be.

        Raises:
            PolicyUnreachableError: Nobody answers.
            ProtocolError: Somebody answers who speaks something else.
        """
        self.where = where
        self._connect = connect
        self.manners = manners
        self._channel: Channel | None = None
        self._connection = 0
        self._asked = 0
        self._episodes: WeakKeyDictionary[View, dict[object, _Episode]]
        self._episodes = WeakKeyDictionary()
        self._numbered = 0
        self._forgotten: list[int] = []
        self.hello: Message = {}
        self._open(manners.first_patience_s)

    def close(self) -> None:
        """Hang up; the next question connects again."""
        if self._channel is not None:
            self._channel.close()
        self._channel = None

    def decide(
        self,
        method: str,
        inputs: Sequence[PolicyInput],
        subtasks: Sequence[SubTask] = (),
    ) -> Message:
        """Return the answer to a question about episodes.

        Args:
            method: ``"act"``, ``"plan"`` or ``"ground"``.
            inputs: One per episode.
            subtasks: One per episode, to ground them.

        Raises:
            PolicyFailedError: It raised, did not answer in time, or died of it.
            PolicyUnreachableError: Nobody answers any more.
        """
        allowed_s = self.manners.timeout_s * len(inputs)
        for _ in range(self.manners.deaths):
            if self._channel is None:
                self._open(self.manners.patience_s)
            try:
                end = time.monotonic() + allowed_s
                return self._tell_and_ask(method, inputs, subtasks, end)
            except TimeoutError as error:
                self.close()
                raise PolicyFailedError(
                    FaultKind.TIMEOUT,
                    f"The policy did not decide within {allowed_s:g} s "
                    f"({len(inputs)} decisions of {self.manners.timeout_s:g} s).",
                ) from error
            except OSError as error:
                self.close()
                last = error
        raise PolicyFailedError(
            FaultKind.DIED, f"{self.where} ended whenever it was asked this: {last}."
        )

    def ask(self, message: Message, timeout_s: float) -> Message:
        """Return the answer to any message, whatever it is.

        Raises:
            TimeoutError: There is none in time.
            OSError: The other side is gone.
        """
        if self._channel is None:
            self._open(self.manners.patience_s)
        assert self._channel is not None
        self._asked += 1
        end = time.monotonic() + timeout_s
        self._channel.send({**message, "id": self._asked})
        while True:
            reply = self._channel.receive(max(0.0, end - time.monotonic()))
            if reply.get("id") == self._asked:
                return reply

    def _tell_and_ask(
        self,
        method: str,
        inputs: Sequence[PolicyInput],
        subtasks: Sequence[SubTask],
        end: float,
    ) -> Message:
        episodes = [self._episode(given) for given in inputs]
        for _ in range(_MISSES):
            self._reset(inputs, episodes, end)
            message: Message = {
                "type": method,
                "inputs": [
                    self._input(given, episode)
                    for given, episode in zip(inputs, episodes, strict=True)
                ],
            }
            if method == "ground":
                message["subtasks"] = [subtask_to_message(s) for s in subtasks]
            reply = self._expect(self.ask(message, end - time.monotonic()))
            for episode, asked in zip(episodes, message["inputs"], strict=True):
                episode.sent.update(number for number, _ in asked["views"])
            if reply["type"] != "missing":
                return reply
            self._unlearn(episodes, reply)
        raise ProtocolError(
            f"{self.where} misses views again and again, although they were sent."
        )

    def _episode(self, given: PolicyInput) -> _Episode:
        """Return what is known of an episode: it is the one of this first view."""
        first = given.past[0].view if given.past else given.view
        alike = self._episodes.setdefault(first, {})
        key = (given.instruction, given.robots)
        if key not in alike:
            alike[key] = _Episode(self._numbered)
            finalize(first, self._forgotten.append, self._numbered)
            self._numbered += 1
        return alike[key]

    def _reset(
        self, inputs: Sequence[PolicyInput], episodes: list[_Episode], end: float
    ) -> None:
        """Announce the episodes that this connection does not know."""
        new = {}
        for given, episode in zip(inputs, episodes, strict=True):
            if episode.connection != self._connection:
                new[episode.number] = {
                    "episode": episode.number,
                    "instruction": given.instruction,
                    "robots": list(given.robots),
                }
        if not new:
            return
        forget = self._forgotten[:]
        message = {"type": "reset", "episodes": list(new.values()), "forget": forget}
        self._expect(self.ask(message, end - time.monotonic()))
        del self._forgotten[: len(forget)]
        for episode in episodes:
            if episode.number in new:
                episode.connection = self._connection
                episode.sent.clear()

    def _input(self, given: PolicyInput, episode: _Episode) -> Message:
        past = [
            {
                "view": episode.name(step.view),
                "subtask": subtask_to_message(step.subtask),
                "outcome": step.outcome,
            }
            for step in given.past
        ]
        views = {episode.name(v): v for v in (*(s.view for s in given.past),)}
        views[episode.name(given.view)] = given.view
        return {
            "episode": episode.number,
            "views": [
                [number, view_to_message(view)]
                for number, view in views.items()
                if number not in episode.sent
            ],
            "view": episode.name(given.view),
            "past": past,
        }

    def _unlearn(self, episodes: list[_Episode], missing: Message) -> None:
        unknown = set(missing.get("episodes", ()))
        unseen = {tuple(pair) for pair in missing.get("views", ())}
        for episode in episodes:
            if episode.number in unknown:
                episode.connection = -1
            episode.sent -= {n for number, n in unseen if number == episode.number}

    def _expect(self, reply: Message) -> Message:
        """Return an answer unless it is an error.

        Raises:
            PolicyFailedError: The policy raised or answered nonsense.
            ProtocolError: The other side did not understand.
        """
        if reply["type"] != "error":
            return reply
        kind, text = reply.get("kind"), str(reply.get("message", ""))
        if kind in set(FaultKind):
            raise PolicyFailedError(FaultKind(kind), text)
        raise ProtocolError(f"{self.where} refuses: {text}")

    def _open(self, patience_s: float) -> None:
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
                self._connection += 1
                greeting = {"type": "hello", "protocol": PROTOCOL}
                self.hello = self._greeted(self.ask(greeting, _HELLO_S))
                return
            except OSError as error:
                self.close()
                if time.monotonic() + pause_s > end:
                    raise PolicyUnreachableError(
                        f"Nobody answers at {self.where}: {error}. Tried for "
                        f"{patience_s:g} s. Start the policy there (lemma serve) and "
                        "run the same command again: what was finished is kept."
                    ) from error
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    def _greeted(self, reply: Message) -> Message:
        self._expect(reply)
        if reply["type"] != "hello" or reply.get("protocol") != PROTOCOL:
            raise ProtocolError(
                f"{self.where} speaks version {reply.get('protocol')!r} of the policy "
                f"protocol, and this is version {PROTOCOL}. Install the same version "
                "of lemma-bench on both sides."
            )
        entries(reply, "methods")
        return reply
