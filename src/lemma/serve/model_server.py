"""A client for model servers of vla-eval, with the interface of control policies.

These servers keep chunks of actions and histories. Each episode therefore has its own
connection, and no request can be repeated.
"""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np

from lemma.core.errors import InvalidConfigError, shown
from lemma.core.robot_names import robot_names
from lemma.policies.control.interfaces import (
    MODEL_SERVER,
    Actions,
    ControlInput,
    is_model_server,
)
from lemma.serve import vla_eval
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
from lemma.serve.vla_eval import Kind, Message
from lemma.serve.websocket import WebSocketChannel, check_no_secret, websocket_address

_SHOWN = 500
_BENCHMARK = "lemma_vla_eval:LemmaBenchmark"
_TASK = {"name": "lemma", "suite": "lemma"}
"""Task of every episode; policies do not get the real name."""


def _address(url: str) -> str:
    """Return an address with the scheme of WebSockets.

    Raises:
        InvalidConfigError: It is not the address of a model server.
    """
    check_no_secret(url)
    try:
        plain = url[len(MODEL_SERVER) :] if is_model_server(url) else url
        return websocket_address(f"ws{plain}")
    except InvalidConfigError as error:
        raise InvalidConfigError(
            f"{shown(url)} is not the address of a model server. Write it as in "
            f"{MODEL_SERVER}://127.0.0.1:8001."
        ) from error


class ModelServer:
    """A control policy on a model server of vla-eval, and the connections to it."""

    def __init__(self, url: str, mode: ProtocolMode) -> None:
        """Connect for the first time.

        Args:
            url: Address such as ``"vla-eval://127.0.0.1:8001"``.
            mode: Time limits and retries.

        Raises:
            InvalidConfigError: The address is not valid, or the extra is not installed.
            PolicyUnreachableError: There was no connection in time.
            ProtocolError: The other side uses another protocol.
        """
        self.url, self.mode = url, mode
        self._address = _address(url)
        first, self.welcome = self._open(mode.first_patience_s)
        self.idle = [first]
        """Connections without an episode."""
        # Numbers are unique over all connections, so an answer fits one request only.
        self._numbers = count(1)
        self.control_options: dict[str, Any] = {}

    def use(
        self,
        options: Mapping[str, Any],
        columns: Sequence[str],
        state: Sequence[str] = ("agent_pos",),
    ) -> None:
        """Choose the environment in which it acts.

        Args:
            options: Options of the environment.
            columns: Meaning of each number of one robot's action.
            state: Parts of the sent state, in order.

        Raises:
            InvalidConfigError: The server declares other actions.
        """
        self.control_options = dict(options)
        self._columns, self._state = tuple(columns), tuple(state)
        # Assume two robots here; the environment knows the size of other teams.
        names, control = self._names(2), options["control"]
        spec = self.welcome.get("action_spec")
        parts = spec.values() if isinstance(spec, dict) else ()
        declared = [part for part in parts if isinstance(part, dict)]
        formats = {part.get("format") for part in declared}
        counts = [part.get("dims") for part in declared]
        numbers = sum(dims for dims in counts if isinstance(dims, int))
        own = vla_eval.format_of(control)
        if not formats <= {"raw", own} or numbers not in (0, len(names)):
            raise InvalidConfigError(
                f"{self.url} declares the actions {shown(spec)}, and control mode "
                f"{control!r} takes {len(names)} numbers, {names[0]} to {names[-1]}, "
                f"whose format is {own!r} or 'raw'. Choose the control mode that the "
                "model was trained for, or convert on the server."
            )

    @property
    def about(self) -> dict[str, Any]:
        """The server's description of itself, and the chosen options."""
        said = ("model_server", "harness_version", "action_spec", "observation_spec")
        return {
            **{name: self.welcome[name] for name in said if name in self.welcome},
            "control_options": self.control_options,
            "state": list(self._state),
        }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions | PolicyFailedError]:
        """Return the next action of each episode, or its fault.

        All requests are sent before the first answer is read, so servers may answer
        them as one batch. A fault fails only its own episode.

        Raises:
            PolicyUnreachableError: The connection is lost and cannot be opened again.
            ProtocolError: A message is larger than servers accept.
        """
        allowed_s = self.mode.timeout_s * len(inputs)
        end = time.monotonic() + allowed_s
        episodes: list[ServedEpisode] = [
            control_input.memory or self._begin(len(control_input.robots))
            for control_input in inputs
        ]
        asked = [
            _attempt(episode.ask, self._seen(control_input))
            for episode, control_input in zip(episodes, inputs, strict=True)
        ]
        found = [
            failed or _attempt(episode.answer, end, allowed_s)
            for episode, failed in zip(episodes, asked, strict=True)
        ]
        if any(getattr(one, "kind", None) is FaultKind.DIED for one in found):
            # If the server is gone, the run ends, and the episode has not failed.
            self.idle.append(self._open(self.mode.patience_s)[0])
        return found

    def close(self) -> None:
        """Close all connections."""
        while self.idle:
            self.idle.pop().close()

    def message(self, kind: Kind, payload: Mapping[str, Any]) -> tuple[int, bytes]:
        """Return the number and the bytes of a new message."""
        number = next(self._numbers)
        return number, vla_eval.pack(Message.of(kind, payload, number))

    def _names(self, robots: int) -> list[str]:
        """Return the meaning of each number of a team's action."""
        names = robot_names(robots)
        return [f"{robot}.{column}" for robot in names for column in self._columns]

    def _seen(self, control_input: ControlInput) -> dict[str, Any]:
        parts = [np.ravel(control_input.observation[part]) for part in self._state]
        pixels = control_input.observation.get("pixels", {})
        return vla_eval.observation(
            pixels,
            control_input.instruction,
            np.concatenate(parts),
            control_input.robots,
        )

    def _begin(self, robots: int) -> "ServedEpisode":
        """Begin an episode on the server, and return it.

        Raises:
            PolicyUnreachableError: There was no connection in time.
            ProtocolError: The other side uses another protocol.
        """
        while True:
            idle = self.idle.pop() if self.idle else None
            channel = idle or self._open(self.mode.patience_s)[0]
            try:
                channel.send(self.message(Kind.EPISODE_START, {"task": _TASK})[1])
            except OSError:
                channel.close()
            else:
                return ServedEpisode(self, channel, robots, self._names(robots))

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
                f"{self.url} does not answer 'hello' like a model server of vla-eval: "
                f"{error or 'there is no answer.'} The address of a policy of "
                "'lemma serve' begins with http://."
            ) from error

    def _greet(self, channel: Channel) -> dict[str, Any]:
        own = vla_eval.hello(benchmark=_BENCHMARK)
        channel.send(vla_eval.pack(Message.of(Kind.HELLO, own)))
        data = channel.receive(HELLO_S)
        if len(data) > LARGEST_HELLO_BYTES:
            raise ProtocolError(f"it says {len(data)} bytes.")
        reply = vla_eval.unpack(data)
        if reply.kind is not Kind.HELLO:
            raise ProtocolError(f"it says {reply.kind}: {shown(dict(reply.payload))}.")
        version = reply.payload.get("protocol_version")
        if version != vla_eval.VERSION:
            raise ProtocolError(
                f"It uses version {shown(version)} of vla-eval's protocol, this client "
                f"version {vla_eval.VERSION}. Install vla-eval 0.8 there."
            )
        return dict(reply.payload)


class ServedEpisode:
    """One episode, and its connection to the server.

    The episode ends on the server when this object is deleted.
    """

    def __init__(
        self, server: ModelServer, channel: Channel, robots: int, names: Sequence[str]
    ) -> None:
        """Use a connection on which the episode has begun."""
        self._server, self._robots, self._names = server, robots, tuple(names)
        self._channel: Channel | None = channel
        self._seq = 0

    def ask(self, observation: Mapping[str, Any]) -> None:
        """Send an observation.

        Raises:
            PolicyFailedError: The connection has ended.
        """
        try:
            if self._channel is None:
                raise ConnectionError("it had done so before")
            self._seq, message = self._server.message(Kind.OBSERVATION, observation)
            self._channel.send(message)
        except OSError as error:
            raise self._failed(error) from error

    def answer(self, end: float, allowed_s: float) -> Actions:
        """Return the action for the last observation, and this episode as memory.

        Args:
            end: Time limit on the monotonic clock [s].
            allowed_s: The whole time allowed, for error messages [s].

        Raises:
            PolicyFailedError: There is no valid answer in time.
            PolicyUnreachableError: The server's machine lacks memory, disk or files.
        """
        try:
            reply = self._next(end)
        except TimeoutError as error:
            why = f"The model server did not act within {allowed_s:g} s."
            raise self._failed(error, FaultKind.TIMEOUT, why) from error
        except OSError as error:
            raise self._failed(error) from error
        except ProtocolError as error:
            raise self._failed(error, FaultKind.MALFORMED, str(error)) from error
        if reply.kind is Kind.ERROR:
            said = str(reply.payload.get("error", reply.payload))[:_SHOWN]
            if reply.payload.get("kind") == UNAVAILABLE:
                raise PolicyUnreachableError(f"The model server says: {said}")
            raise PolicyFailedError(FaultKind.RAISED, f"The model server says: {said}")
        row = vla_eval.read_action(reply.payload, self._names)
        return Actions(row.reshape(self._robots, -1), self)

    def _next(self, end: float) -> Message:
        """Return the answer to the last message, or the error of an earlier one.

        Late answers to earlier messages are skipped.
        """
        assert self._channel is not None
        while True:
            left_s = max(0.0, end - time.monotonic())
            reply = vla_eval.unpack(self._channel.receive(left_s))
            if reply.kind is Kind.ERROR:
                if reply.seq != self._seq:
                    # Otherwise a late answer would be read as that of the next message.
                    self._hang_up()
                return reply
            if reply.kind is Kind.ACTION and reply.seq == self._seq:
                return reply

    def _failed(
        self, error: Exception, kind: FaultKind = FaultKind.DIED, why: str = ""
    ) -> PolicyFailedError:
        """Close the connection, and return the fault; by default, a lost connection."""
        self._hang_up()
        return PolicyFailedError(
            kind, why or f"{self._server.url} hung up in this episode: {error}."
        )

    def _hang_up(self) -> None:
        if self._channel is not None:
            self._channel.close()
        self._channel = None

    def __del__(self) -> None:
        """End the episode on the server, and reuse the connection for another one."""
        if self._channel is None or sys.is_finalizing():
            return
        try:
            self._channel.send(self._server.message(Kind.EPISODE_END, {})[1])
        except OSError:
            self._channel.close()
        else:
            self._server.idle.append(self._channel)


def _attempt(call: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a call, or the fault that it raises."""
    try:
        return call(*arguments)
    except PolicyFailedError as error:
        return error
