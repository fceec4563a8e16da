"""Messages of the policy protocol; docs/serving.md lists them all.

Each is a struct, and becomes a msgpack map with a ``type``. Sub-tasks and decisions
travel as the records that policies use, so the names of their fields are part of the
protocol.
"""

import math
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any, Self, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError, shown
from lemma.env.view import View
from lemma.policies.control.interfaces import ControlInput
from lemma.policies.interfaces import Decision
from lemma.scene.cameras import Camera
from lemma.serve.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.tasks.subtask import GroundedSubTask, SubTask

PROTOCOL = 2
"""Version of the protocol: the first thing that both sides compare."""
METHODS = ("act", "plan", "ground")
"""Methods that a policy may have."""
LARGEST_BYTES = 1 << 28
"""Largest message: ten episodes with all their views need far less."""
VIEW_ARRAYS = {
    "rgb": ("uint8", 3),
    "height_m": ("float32", 2),
    "coverage": ("bool", 2),
    "joints": ("float64", 2),
    "opening_m": ("float64", 1),
}
"""Type and number of dimensions of every array of a view."""
ARRAY_TYPES = ("bool", "int8", "uint8", "int64", "float32", "float64")
"""Valid types of numbers."""


class Array(msgspec.Struct):
    """An array, little-endian, last index fastest."""

    dtype: str
    shape: list[int]
    data: memoryview

    @classmethod
    def of(cls, array: NDArray[Any], dtype: str) -> Self:
        """Return an array as a message."""
        plain = np.ascontiguousarray(array, np.dtype(dtype).newbyteorder("<"))
        return cls(dtype, list(plain.shape), memoryview(plain.tobytes()))

    def read(self, name: str) -> NDArray[Any]:
        """Return the array, read-only.

        Args:
            name: For messages to people.

        Raises:
            ProtocolError: It is damaged.
        """
        if self.dtype not in ARRAY_TYPES:
            raise ProtocolError(
                f"The array {name!r} is of {self.dtype!r:.40}. Valid: "
                f"{', '.join(ARRAY_TYPES)}."
            )
        stored = np.dtype(self.dtype).newbyteorder("<")
        wanted = math.prod(self.shape) * stored.itemsize
        if min(self.shape, default=0) < 0 or wanted != self.data.nbytes:
            raise ProtocolError(
                f"The array {name!r} of shape {shown(self.shape)} has "
                f"{self.data.nbytes} bytes, not {shown(wanted)}."
            )
        try:
            return np.frombuffer(self.data, stored).reshape(self.shape)
        except (ValueError, OverflowError) as error:
            raise ProtocolError(f"The array {name!r} cannot be: {error}.") from error


class ViewMessage(msgspec.Struct):
    """A view, and the number by which inputs refer to it on this connection."""

    number: int
    rgb: Array
    height_m: Array
    coverage: Array
    joints: Array
    opening_m: Array

    @classmethod
    def of(cls, number: int, view: View) -> Self:
        """Return a view as a message."""
        arrays = {
            name: Array.of(getattr(view, name), dtype)
            for name, (dtype, _) in VIEW_ARRAYS.items()
        }
        return cls(number, **arrays)

    def read(self) -> View:
        """Return the view.

        Raises:
            ProtocolError: An array is of another type or shape, or damaged.
        """
        arrays = {}
        for name, (dtype, dimensions) in VIEW_ARRAYS.items():
            array = getattr(self, name)
            if (array.dtype, len(array.shape)) != (dtype, dimensions):
                raise ProtocolError(
                    f"The array {name!r} of a view is {array.dtype!r:.40} with "
                    f"{len(array.shape)} dimensions, not {dtype} with {dimensions}."
                )
            arrays[name] = array.read(name)
        return View(**arrays)


class StepMessage(msgspec.Struct):
    """A decision of the past."""

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


class ControlMessage(msgspec.Struct):
    """The input of a policy at control level for an episode."""

    episode: int
    """Number of the episode on this connection; the memory of it stays on the policy's
    side."""
    step: int
    time_s: float
    instruction: str
    robots: list[str]
    arrays: dict[str, Array]
    """The observation: ``agent_pos``, ``pixels/robot_0``."""
    cameras: dict[str, Camera] = {}

    @classmethod
    def of(cls, given: ControlInput, episode: int) -> Self:
        """Return an input as a message; its memory stays where the policy is.

        Args:
            given: The input.
            episode: Number of the episode on this connection.
        """
        return cls(
            episode=episode,
            step=given.step,
            time_s=given.time_s,
            instruction=given.instruction,
            robots=list(given.robots),
            arrays=_flat(given.observation),
            cameras=dict(given.cameras),
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
    """A message that says what it is."""


class Hello(_Tagged, tag="hello"):
    """The first message of a connection."""

    protocol: int


class Act(_Tagged, tag="act"):
    """Asks for decisions."""

    inputs: list[InputMessage]
    views: list[ViewMessage]
    """The views that the last request on this connection did not refer to."""


class Plan(Act, tag="plan"):
    """Asks for sub-tasks."""


class Ground(Act, tag="ground"):
    """Asks for poses of sub-tasks."""

    subtasks: list[SubTask]


class Control(_Tagged, tag="control"):
    """Asks for motor commands."""

    inputs: list[ControlMessage]


class Welcome(_Tagged, tag="hello"):
    """Answers the first message."""

    protocol: int
    methods: list[str] = []
    policy: dict[str, Any] = {}
    lemma: str = ""


class Decisions(_Tagged, tag="decisions"):
    """Answers ``act``."""

    decisions: list[Decision]


class Commands(_Tagged, tag="commands"):
    """Answers ``control``: an action or a chunk of actions for each input."""

    actions: list[Array]


class SubTasks(_Tagged, tag="subtasks"):
    """Answers ``plan``."""

    subtasks: list[SubTask]


class Poses(_Tagged, tag="poses"):
    """Answers ``ground``."""

    poses: list[GroundedSubTask | None]


class Error(_Tagged, tag="error"):
    """Answers a request that cannot be answered otherwise."""

    kind: str
    message: str


Request = Hello | Act | Plan | Ground | Control
Reply = Welcome | Decisions | SubTasks | Poses | Commands | Error

M = TypeVar("M")


def plain(value: object) -> object:
    """Return a number of NumPy's as what msgpack has.

    Raises:
        TypeError: It is something else.
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
        PolicyFailedError: A policy's answer holds something else than plain data.
    """
    try:
        return _encoder.encode(message)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise malformed(str(error)) from error


def decode_request(data: bytes | str) -> Request:
    """Return a request from bytes; arrays refer to the bytes.

    Raises:
        ProtocolError: They are no request.
    """
    try:
        return decode(_requests, data)
    except msgspec.ValidationError as error:
        raise ProtocolError(f"The request does not fit: {error}.") from error


def decode_reply(data: bytes | str) -> Reply:
    """Return an answer from bytes.

    Raises:
        PolicyFailedError: It has another form, or names a primitive that is not there.
        ProtocolError: They are no message at all.
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
        decoder: Says of which type it is.
        data: The message.

    Raises:
        ValidationError: It is of another type.
        ProtocolError: They are no message at all.
    """
    if isinstance(data, str):
        raise ProtocolError("Messages are binary frames of msgpack, not text.")
    try:
        return decoder.decode(data)
    except msgspec.ValidationError:
        raise
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise ProtocolError(f"A message is no msgpack: {error}.") from error


def malformed(what: str) -> PolicyFailedError:
    """Return the error of a malformed answer."""
    return PolicyFailedError(
        FaultKind.MALFORMED, f"The policy's answer cannot be used: {what}."
    )


def websockets(module: str) -> ModuleType:
    """Import a module of the package websockets, an extra.

    Args:
        module: Such as ``"sync.client"``.

    Raises:
        InvalidConfigError: The package is not installed.
    """
    try:
        return import_module(f"websockets.{module}")
    except ImportError as error:
        raise InvalidConfigError(
            "The package websockets is not installed, without which policies cannot be "
            "reached over a socket. Install it with: pip install 'lemma-bench[serve]'"
        ) from error
