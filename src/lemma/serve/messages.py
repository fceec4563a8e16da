"""Messages of the policy protocol; docs/serving.md lists them all.

Each message is a struct, encoded as a msgpack map with a ``type``. Sub-tasks and
decisions are encoded as the records that policies use, so the names of their fields are
part of the protocol.
"""

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any, Self, TypeVar

import msgspec
import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.env.view import View
from lemma.policies.control.interfaces import ControlInput
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.together.interfaces import Doing, Message, Orders, TeamInput
from lemma.scene.cameras import Camera
from lemma.serve.arrays import Array, ViewMessage
from lemma.serve.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.tasks.subtask import GroundedSubTask, SubTask

PROTOCOL = 2
"""Version of the protocol; both sides compare it in their first messages."""
METHODS = ("act", "plan", "ground", "act_together")
"""Methods that a policy may have."""
LARGEST_BYTES = 1 << 28
"""Size limit of a message [bytes]; ten episodes with all views need far less."""


class StepMessage(msgspec.Struct):
    """An earlier decision, with its outcome."""

    view: int
    subtask: SubTask
    outcome: str
    explanation: str = ""


class InputMessage(msgspec.Struct):
    """The input of a policy for an episode."""

    instruction: str
    robots: list[str]
    view: int
    past: list[StepMessage] = []
    hands: list[str] = []


class TeamMessage(InputMessage, kw_only=True):
    """The input of a team policy for an episode."""

    time_s: float
    free: list[str]
    doing: dict[str, Doing] = {}
    messages: list[Message] = []
    own_views: dict[str, int] = {}

    def read(self, plain: PolicyInput, views: Mapping[int, View]) -> TeamInput:
        """Return the input.

        Args:
            plain: The input as for a sequential policy.
            views: Views by number.
        """
        return TeamInput(
            plain.instruction,
            plain.robots,
            plain.view,
            plain.past,
            plain.hands,
            time_s=self.time_s,
            free=tuple(self.free),
            doing=self.doing,
            messages=tuple(self.messages),
            own_views={name: views[view] for name, view in self.own_views.items()},
        )


class ControlMessage(msgspec.Struct):
    """The input of a policy at control level for an episode."""

    episode: int
    """Number of the episode on this connection. The server keeps the policy's memory
    under this number."""
    step: int
    time_s: float
    instruction: str
    robots: list[str]
    arrays: dict[str, Array]
    """The observation, with names such as ``agent_pos`` and ``pixels/robot_0``."""
    cameras: dict[str, Camera] = {}

    @classmethod
    def of(cls, control_input: ControlInput, episode: int) -> Self:
        """Return an input as a message, without the policy's memory.

        Args:
            control_input: The input.
            episode: Number of the episode on this connection.
        """
        return cls(
            episode=episode,
            step=control_input.step,
            time_s=control_input.time_s,
            instruction=control_input.instruction,
            robots=list(control_input.robots),
            arrays=_flat(control_input.observation),
            cameras=dict(control_input.cameras),
        )

    def read(self, memory: Any) -> ControlInput:
        """Return the input.

        Args:
            memory: Memory of the policy in this episode.

        Raises:
            ProtocolError: An array is damaged.
        """
        observation: dict[str, Any] = {}
        for path, array in self.arrays.items():
            *groups, name = path.split("/")
            place = observation
            for group in groups:
                place = place.setdefault(group, {})
            place[name] = array.read(path)
        return ControlInput(
            instruction=self.instruction,
            robots=tuple(self.robots),
            observation=observation,
            cameras=self.cameras,
            step=self.step,
            time_s=self.time_s,
            memory=memory,
        )


def _flat(observation: Mapping[str, Any], prefix: str = "") -> dict[str, Array]:
    found: dict[str, Array] = {}
    for name, value in observation.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{name}/")
        else:
            array = np.asarray(value)
            found[prefix + name] = Array.of(array, array.dtype.name)
    return found


class _Tagged(msgspec.Struct, tag_field="type", kw_only=True):
    """Base of messages with a ``type``."""


class Hello(_Tagged, tag="hello"):
    """The first message of a connection."""

    protocol: int


class Act(_Tagged, tag="act"):
    """Request for decisions."""

    inputs: list[InputMessage]
    views: list[ViewMessage]
    """Views to which the last request on this connection did not refer."""


class Plan(Act, tag="plan"):
    """Request for sub-tasks."""


class Together(_Tagged, tag="together"):
    """Request for orders to the free robots of teams."""

    inputs: list[TeamMessage]
    views: list[ViewMessage]


class Ground(Act, tag="ground"):
    """Request for poses of sub-tasks."""

    subtasks: list[SubTask]


class Control(_Tagged, tag="control"):
    """Request for motor commands."""

    inputs: list[ControlMessage]


class Welcome(_Tagged, tag="hello"):
    """Answer to ``hello``."""

    protocol: int
    methods: list[str] = []
    policy: dict[str, Any] = {}
    lemma: str = ""


class Decisions(_Tagged, tag="decisions"):
    """Answer to ``act``."""

    decisions: list[Decision]


class AllOrders(_Tagged, tag="orders"):
    """Answer to ``together``."""

    orders: list[Orders]


class Commands(_Tagged, tag="commands"):
    """Answer to ``control``: an action or a chunk of actions for each input."""

    actions: list[Array]


class SubTasks(_Tagged, tag="subtasks"):
    """Answer to ``plan``."""

    subtasks: list[SubTask]


class Poses(_Tagged, tag="poses"):
    """Answer to ``ground``."""

    poses: list[GroundedSubTask | None]


class Error(_Tagged, tag="error"):
    """Answer to a request that failed."""

    kind: str
    message: str


Request = Hello | Act | Plan | Ground | Together | Control
Reply = Welcome | Decisions | SubTasks | Poses | AllOrders | Commands | Error

M = TypeVar("M")


def plain(value: object) -> object:
    """Return a NumPy number as a Python number, which msgpack can encode.

    Raises:
        TypeError: The value is of another type.
    """
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a {type(value).__name__} cannot be sent")


_encoder = msgspec.msgpack.Encoder(enc_hook=plain)
_requests: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
_replies: msgspec.msgpack.Decoder[Reply] = msgspec.msgpack.Decoder(Reply)


def encode(message: Request | Reply) -> bytes:
    """Return a message as bytes.

    Raises:
        PolicyFailedError: A policy's answer contains values other than plain data.
    """
    try:
        return _encoder.encode(message)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise malformed(str(error)) from error


def decode_request(data: bytes | str) -> Request:
    """Return a request from bytes; arrays refer to the bytes.

    Raises:
        ProtocolError: They are not a valid request.
    """
    try:
        return decode(_requests, data)
    except msgspec.ValidationError as error:
        raise ProtocolError(f"The request is not valid: {error}.") from error


def decode_reply(data: bytes | str) -> Reply:
    """Return an answer from bytes.

    Raises:
        PolicyFailedError: The answer is malformed, or names an unknown primitive.
        ProtocolError: The bytes are not a message.
    """
    try:
        return decode(_replies, data)
    except msgspec.ValidationError as error:
        if "enum" in str(error):
            raise PolicyFailedError(
                FaultKind.UNKNOWN_NAME, f"The policy names no primitive: {error}."
            ) from error
        raise malformed(str(error)) from error


def decode(decoder: msgspec.msgpack.Decoder[M], data: bytes | str) -> M:
    """Return a message from bytes.

    Args:
        decoder: Decoder for the expected type.
        data: The message.

    Raises:
        ValidationError: The message is of another type.
        ProtocolError: The bytes are not a message.
    """
    if isinstance(data, str):
        raise ProtocolError("Messages are binary frames of msgpack, not text.")
    try:
        return decoder.decode(data)
    except msgspec.ValidationError:
        raise
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise ProtocolError(f"A message is not msgpack: {error}.") from error


def malformed(what: str) -> PolicyFailedError:
    """Return the error of a malformed answer."""
    return PolicyFailedError(
        FaultKind.MALFORMED, f"The policy's answer cannot be used: {what}."
    )


def websockets(module: str) -> ModuleType:
    """Import a module of the optional package websockets.

    Args:
        module: Name of the module, such as ``"sync.client"``.

    Raises:
        InvalidConfigError: The package is not installed.
    """
    try:
        return import_module(f"websockets.{module}")
    except ImportError as error:
        raise InvalidConfigError(
            "The package websockets is not installed; policies behind a socket need "
            "it. Install it with: pip install 'lemma-bench[serve]'"
        ) from error
