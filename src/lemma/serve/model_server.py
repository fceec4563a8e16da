"""A model server of vla-eval behind the interface of policies at control level.

Its servers keep chunks of actions and histories. So each episode has a connection of
its own, and no question can be asked twice.
"""

import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError, shown
from lemma.core.robot_names import robot_names
from lemma.policies.control.interfaces import (
    MODEL_SERVER,
    Actions,
    ControlInput,
    is_model_server,
)
from lemma.serve.conversation import (
    HELLO_S,
    LARGEST_HELLO_BYTES,
    Channel,
    ProtocolMode,
    keep_trying,
)
from lemma.serve.faults import (
    UNAVAILABLE,
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.vla_eval import (
    Kind,
    Message,
    check_version,
    format_of,
    hello,
    observation,
    pack,
    read_action,
    unpack,
)
from lemma.serve.websocket import (
    WebSocketChannel,
    check_no_secret,
    websocket_address,
)

_SHOWN = 500
_BENCHMARK = "lemma_vla_eval:LemmaBenchmark"
_TASK = {"name": "lemma", "suite": "lemma"}
"""Task of every episode: policies do not get its name."""


def _address(url: str) -> str:
    """Return an address with the scheme of WebSockets.

    Raises:
        InvalidConfigError: It is none of a model server.
    """
    check_no_secret(url)
    try:
        plain = url[len(MODEL_SERVER) :] if is_model_server(url) else url
        return websocket_address(f"ws{plain}")
    except InvalidConfigError as error:
        raise InvalidConfigError(
            f"{shown(url)} is no address of a model server. Write it as in "
            f"{MODEL_SERVER}://127.0.0.1:8001."
        ) from error


class ModelServer:
    """A model server of vla-eval, and the connections to it."""

    def __init__(self, url: str, mode: ProtocolMode) -> None:
        """Connect for the first time.

        Args:
            url: Such as ``"vla-eval://127.0.0.1:8001"``.
            mode: How patient to be.

        Raises:
            InvalidConfigError: The address is none, or the extra is not installed.
            PolicyUnreachableError: Nobody answers there.
            ProtocolError: The other side speaks another protocol.
        """
        self.url, self.mode = url, mode
        self._address = _address(url)
        first, self.welcome = self._open(mode.first_patience_s)
        self._idle = [first]
        # Messages of all connections are numbered: an answer belongs to one question.
        self._numbers = count(1)

    @property
    def about(self) -> dict[str, Any]:
        """Description that the server gives of itself, ready for JSON."""
        said = ("model_server", "harness_version", "action_spec", "observation_spec")
        return {name: self.welcome[name] for name in said if name in self.welcome}

    def check_actions(self, control: str, names: Sequence[str]) -> None:
        """Check that the server declares the actions that are taken here, if any.

        Args:
            control: Control mode.
            names: Meaning of each number of an action.

        Raises:
            InvalidConfigError: It declares others.
        """
        spec = self.welcome.get("action_spec")
        if not isinstance(spec, dict) or not spec:
            return
        declared = {
            name: (part.get("format"), part.get("dims"))
            for name, part in spec.items()
            if isinstance(part, dict)
        }
        formats = {found for found, _ in declared.values()}
        numbers = sum(dims for _, dims in declared.values() if isinstance(dims, int))
        fits = formats <= {"raw", format_of(control)} and numbers in (0, len(names))
        if not fits:
            raise InvalidConfigError(
                f"{self.url} declares the actions {shown(declared)}, and control mode "
                f"{control!r} takes {len(names)} numbers, {names[0]} to {names[-1]}, "
                f"whose format is {format_of(control)!r} or 'raw'. Choose the control "
                "mode that the model was trained for, or convert on the server."
            )

    def begin(self, task: Mapping[str, Any], names: Sequence[str]) -> "ServedEpisode":
        """Return an episode, which begins there.

        Args:
            task: Description for the server, without the goal.
            names: Meaning of each number of an action.

        Raises:
            PolicyUnreachableError: Nobody answers any more.
            ProtocolError: The other side speaks another protocol.
        """
        episode = ServedEpisode(self, dict(task), tuple(names))
        while self._idle:
            if episode.start(self._idle.pop()):
                return episode
        while True:
            if episode.start(self._open(self.mode.patience_s)[0]):
                return episode

    def act(
        self,
        episodes: Sequence["ServedEpisode"],
        observations: Sequence[Mapping[str, Any]],
    ) -> list[NDArray[Any] | PolicyFailedError]:
        """Return the next action of each episode, or why it has none.

        All are asked before the first answer is waited for: servers may answer them as
        one batch. A fault costs its own episode.

        Args:
            episodes: At least one.
            observations: One per episode; see
                :func:`lemma.serve.vla_eval.observation`.

        Raises:
            PolicyUnreachableError: Nobody answers any more.
        """
        allowed_s = self.mode.timeout_s * len(episodes)
        end = time.monotonic() + allowed_s
        asked = [
            _attempt(partial(episode.ask, seen))
            for episode, seen in zip(episodes, observations, strict=True)
        ]
        found: list[NDArray[Any] | PolicyFailedError] = []
        for episode, failed in zip(episodes, asked, strict=True):
            if failed is None:
                found.append(_attempt(partial(episode.answer, end, allowed_s)))
            else:
                found.append(failed)
        died = [
            one
            for one in found
            if isinstance(one, PolicyFailedError) and one.kind is FaultKind.DIED
        ]
        if died:
            # A server that is gone for good ends the run and has not failed.
            self._idle.append(self._open(self.mode.patience_s)[0])
        return found

    def take_back(self, channel: Channel) -> None:
        """Keep a connection for the next episode."""
        self._idle.append(channel)

    def number(self) -> int:
        """Return the number of a new message."""
        return next(self._numbers)

    def close(self) -> None:
        """Hang up."""
        while self._idle:
            self._idle.pop().close()

    def _open(self, patience_s: float) -> tuple[Channel, dict[str, Any]]:
        """Return a new connection, and the answer to its hello."""
        channel = keep_trying(
            lambda: WebSocketChannel(self._address), self.url, patience_s
        )
        try:
            return channel, self._greet(channel)
        except (OSError, ProtocolError) as error:
            channel.close()
            raise ProtocolError(
                f"{self.url} does not answer 'hello' as a model server of vla-eval "
                f"does: {error or 'it says nothing'} The address of a policy of "
                "'lemma serve' begins with http://."
            ) from error

    def _greet(self, channel: Channel) -> dict[str, Any]:
        channel.send(pack(Message.of(Kind.HELLO, hello(benchmark=_BENCHMARK))))
        data = channel.receive(HELLO_S)
        if len(data) > LARGEST_HELLO_BYTES:
            raise ProtocolError(f"it says {len(data)} bytes.")
        reply = unpack(data)
        if reply.kind is not Kind.HELLO:
            raise ProtocolError(f"it says {reply.kind}: {shown(dict(reply.payload))}.")
        check_version(reply.payload, self.url)
        return dict(reply.payload)


class ServedEpisode:
    """One episode, and the connection on which the server knows it."""

    def __init__(
        self, server: ModelServer, task: Mapping[str, Any], names: tuple[str, ...]
    ) -> None:
        """Prepare; :meth:`ModelServer.begin` starts it."""
        self._server, self._task, self._names = server, task, names
        self._channel: Channel | None = None
        self._seq = 0

    def start(self, channel: Channel) -> bool:
        """Begin on a connection; whether it was still there."""
        try:
            channel.send(self._message(Kind.EPISODE_START, {"task": self._task}))
        except OSError:
            channel.close()
            return False
        self._channel = channel
        return True

    def ask(self, observation: Mapping[str, Any]) -> None:
        """Send an observation.

        Raises:
            PolicyFailedError: The connection has ended.
        """
        if self._channel is None:
            raise PolicyFailedError(
                FaultKind.DIED, f"{self._server.url} has hung up in this episode."
            )
        try:
            self._channel.send(self._message(Kind.OBSERVATION, observation))
        except OSError as error:
            raise self._dead(error) from error

    def answer(self, end: float, allowed_s: float) -> NDArray[Any]:
        """Return the action for the last observation, (n,).

        Args:
            end: Until when to wait, of the monotonic clock [s].
            allowed_s: How long that is in all [s].

        Raises:
            PolicyFailedError: There is none, or none that can be used.
        """
        assert self._channel is not None
        try:
            reply = self._next(end)
        except TimeoutError as error:
            self._hang_up()
            raise PolicyFailedError(
                FaultKind.TIMEOUT,
                f"The model server did not act within {allowed_s:g} s.",
            ) from error
        except OSError as error:
            raise self._dead(error) from error
        except ProtocolError as error:
            self._hang_up()
            raise PolicyFailedError(FaultKind.MALFORMED, str(error)) from error
        if reply.kind is Kind.ERROR:
            said = str(reply.payload.get("error", reply.payload))[:_SHOWN]
            if reply.payload.get("kind") == UNAVAILABLE:
                raise PolicyUnreachableError(f"The model server says: {said}")
            raise PolicyFailedError(FaultKind.RAISED, f"The model server says: {said}")
        return read_action(reply.payload, self._names)

    def end(self, result: Mapping[str, Any]) -> None:
        """Send the result of the episode, and keep the connection for another one."""
        if self._channel is None:
            return
        channel, self._channel = self._channel, None
        try:
            channel.send(self._message(Kind.EPISODE_END, result))
        except OSError:
            channel.close()
        else:
            self._server.take_back(channel)

    def _next(self, end: float) -> Message:
        """Return the answer to the last message, or the error of an earlier one.

        Late answers to earlier messages are passed over.
        """
        assert self._channel is not None
        while True:
            left_s = max(0.0, end - time.monotonic())
            reply = unpack(self._channel.receive(left_s))
            if reply.kind is Kind.ERROR:
                if reply.seq != self._seq:
                    # The answer to the observation would be taken for the next one's.
                    self._hang_up()
                return reply
            if reply.kind is Kind.ACTION and reply.seq == self._seq:
                return reply

    def _message(self, kind: Kind, payload: Mapping[str, Any]) -> bytes:
        self._seq = self._server.number()
        return pack(Message.of(kind, payload, self._seq))

    def _dead(self, error: OSError) -> PolicyFailedError:
        self._hang_up()
        return PolicyFailedError(
            FaultKind.DIED, f"{self._server.url} hung up in this episode: {error}."
        )

    def _hang_up(self) -> None:
        if self._channel is not None:
            self._channel.close()
        self._channel = None


@dataclass(frozen=True, eq=False)
class _Memory:
    """Ends its episode when it is no longer referred to."""

    episode: ServedEpisode

    def __post_init__(self) -> None:
        weakref.finalize(self, self.episode.end, {}).atexit = False


class ModelServerPolicy:
    """Motor commands from a model server of vla-eval."""

    def __init__(
        self,
        server: ModelServer,
        options: Mapping[str, Any],
        columns: Sequence[str],
        state: Sequence[str] = ("agent_pos",),
    ) -> None:
        """Keep the connection.

        Args:
            server: The server.
            options: In which environment it acts.
            columns: Meaning of each number of a robot's row.
            state: Parts of the state that is sent, in order.
        """
        self.server = server
        self.control_options = dict(options)
        self._columns, self._state = tuple(columns), tuple(state)

    @property
    def about(self) -> dict[str, Any]:
        """Description that the server gives of itself, and the chosen options."""
        return {
            **self.server.about,
            "control_options": self.control_options,
            "state": list(self._state),
        }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions | PolicyFailedError]:
        """Return the next action of each episode, or why it has none.

        Raises:
            PolicyUnreachableError: Nobody answers any more.
        """
        memories = [given.memory or self._begin(given) for given in inputs]
        answers = self.server.act(
            [memory.episode for memory in memories], [*map(self._seen, inputs)]
        )
        return [
            answer
            if isinstance(answer, PolicyFailedError)
            else Actions(answer.reshape(len(given.robots), -1), memory)
            for answer, given, memory in zip(answers, inputs, memories, strict=True)
        ]

    def close(self) -> None:
        """Hang up."""
        self.server.close()

    def _begin(self, given: ControlInput) -> _Memory:
        names = [
            f"{robot}.{column}"
            for robot in robot_names(len(given.robots))
            for column in self._columns
        ]
        return _Memory(self.server.begin(_TASK, names))

    def _seen(self, given: ControlInput) -> dict[str, Any]:
        state = np.concatenate(
            [np.ravel(given.observation[part]) for part in self._state]
        )
        pixels = given.observation.get("pixels", {})
        return observation(pixels, given.instruction, state, given.robots)


def _attempt(call: Callable[[], Any]) -> Any:
    """Return what a call returns, or the fault that it raises."""
    try:
        return call()
    except PolicyFailedError as error:
        return error
