"""The messages of vla-eval, version 1 of its protocol: motor commands over a WebSocket.

The harness and the model servers of the package ``vla-eval`` use this protocol. Each
message is a msgpack map of ``type``, ``payload``, ``seq`` and ``timestamp``; an answer
has the ``seq`` of its request. This module does not need that package.
"""

import io
import math
import time
from collections.abc import Mapping, Sequence
from enum import StrEnum
from importlib import import_module
from typing import Any, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError, shown
from lemma.serve.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.serve.messages import decode, plain

VERSION = 1
"""Version of the protocol; both sides send it, and this package compares it."""
_ARRAY, _IMAGE = "__ndarray__", "__image__"
_NUMBERS = "biuf"
_FORMATS = ("png", "jpeg", "raw")
_DEEPEST = 16
_LARGEST_IMAGE = 4096 * 4096


class Kind(StrEnum):
    """The kinds of messages."""

    HELLO = "hello"
    """The first message of a connection; the answer describes the server."""
    EPISODE_START = "episode_start"
    """An episode begins; there is no answer except after an error."""
    OBSERVATION = "observation"
    """An observation; the answer is an action."""
    ACTION = "action"
    EPISODE_END = "episode_end"
    """The result of the episode; there is no answer."""
    ERROR = "error"


class Message(msgspec.Struct, frozen=True):
    """One message."""

    kind: Kind = msgspec.field(name="type")
    payload: dict[str, Any]
    seq: int
    timestamp: float

    @classmethod
    def of(cls, kind: Kind, payload: Mapping[str, Any], seq: int = 0) -> Self:
        """Return a message with the present time."""
        return cls(kind, dict(payload), seq, time.time())


_decoder = msgspec.msgpack.Decoder(Message)


def pack(message: Message) -> bytes:
    """Return a message as bytes; arrays and images are not compressed.

    Raises:
        ProtocolError: The payload contains a value that cannot be encoded.
    """
    try:
        return msgspec.msgpack.encode(message, enc_hook=_plain)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ProtocolError(f"A message cannot be sent: {error}.") from error


def unpack(data: bytes | str) -> Message:
    """Return a message from bytes, with arrays and images as arrays.

    Raises:
        ProtocolError: The bytes are not a valid message.
    """
    try:
        found = decode(_decoder, data)
    except msgspec.ValidationError as error:
        raise ProtocolError(
            f"A message does not fit: {error}. One of vla-eval is a map of type, "
            f"payload, seq and timestamp; types are {', '.join(Kind)}."
        ) from error
    return msgspec.structs.replace(found, payload=_read(found.payload))


def hello(**fields: Any) -> dict[str, Any]:
    """Return the payload of a hello.

    Args:
        fields: Further fields of the payload.
    """
    return {"harness_version": "lemma-bench", "protocol_version": VERSION, **fields}


def observation(
    images: Mapping[str, NDArray[np.uint8]],
    sentence: str,
    state: NDArray[Any] | None,
    robots: Sequence[str] = (),
) -> dict[str, Any]:
    """Return an observation in the format of vla-eval's model servers.

    Args:
        images: RGB images by name of the camera, (H, W, 3).
        sentence: The instruction.
        state: Joints and other numbers of the robots, (n,); None to leave them out.
        robots: Phrases for the robots, in the order of state and action.
    """
    found: dict[str, Any] = {"images": dict(images), "task_description": sentence}
    if robots:
        found["robots"] = list(robots)
    if state is not None:
        found["states"] = np.asarray(state, np.float32)
    return found


def read_action(payload: Mapping[str, Any], names: tuple[str, ...]) -> NDArray[Any]:
    """Return the action of an answer, (n,) float64.

    Args:
        payload: Payload of the answer.
        names: Meaning of each number: ``"robot_0.shoulder_pan"``.

    Raises:
        PolicyFailedError: The action is missing, has a wrong shape, or is not finite.
    """
    key = next((key for key in ("actions", "action") if key in payload), None)
    if key is None:
        keys = ", ".join(map(shown, payload)) or "nothing"
        raise _malformed(f"It holds {keys}, and no 'actions'", names)
    try:
        values = np.asarray(payload[key])
    except (TypeError, ValueError) as error:
        raise _malformed(f"Its {key!r} are no array: {error}", names) from error
    if values.dtype.kind not in "fiu":
        raise _malformed(f"Its {key!r} are {values.dtype}, no numbers", names)
    row = values[0] if values.ndim == 2 and len(values) == 1 else values
    if row.shape != (len(names),):
        chunk = row.ndim == 2 and row.shape[1] == len(names)
        hint = (
            f" That is a chunk: have the server give it out action by action, with "
            f"chunk_size={len(row)}."
            if chunk
            else ""
        )
        raise _malformed(f"Its {key!r} have shape {values.shape}", names, hint)
    if not np.isfinite(row).all():
        wrong = int(np.flatnonzero(~np.isfinite(row))[0])
        raise PolicyFailedError(
            FaultKind.NOT_FINITE, f"In the action, {names[wrong]} is {row[wrong]}."
        )
    return row.astype(np.float64)


def format_of(control: str) -> str:
    """Return the format of a control mode's actions in specs of vla-eval."""
    return f"lemma_{control}"


def _malformed(what: str, names: tuple[str, ...], hint: str = "") -> PolicyFailedError:
    return PolicyFailedError(
        FaultKind.MALFORMED,
        f"The policy's answer cannot be used. {what}. Valid: 'actions' of shape "
        f"({len(names)},), from {names[0]} to {names[-1]}.{hint}",
    )


def _plain(value: object) -> object:
    """Return a NumPy array or number as data that msgpack can encode."""
    if isinstance(value, np.ndarray) and value.dtype.kind in _NUMBERS:
        whole = np.ascontiguousarray(value)
        return {
            _ARRAY: True,
            "data": whole.tobytes(),
            "dtype": whole.dtype.str,
            "shape": list(value.shape),
        }
    return plain(value)


def _read(value: Any, depth: int = 0) -> Any:
    """Return decoded data with its encoded arrays and images as arrays."""
    if depth > _DEEPEST:
        raise ProtocolError(f"A message is more than {_DEEPEST} levels deep.")
    if isinstance(value, dict):
        if _IMAGE in value:
            return _read_image(value)
        if _ARRAY in value:
            return _read_array(value)
        return {key: _read(part, depth + 1) for key, part in value.items()}
    if isinstance(value, list):
        return [_read(part, depth + 1) for part in value]
    return value


def _read_array(sent: dict[Any, Any]) -> NDArray[Any]:
    try:
        dtype, shape = np.dtype(sent["dtype"]), tuple(sent["shape"])
        if dtype.kind not in _NUMBERS or min(shape, default=0) < 0:
            raise ValueError(f"{dtype} of shape {shape}")
        wanted = math.prod(shape) * dtype.itemsize
        if wanted != len(sent["data"]):
            raise ValueError(f"{len(sent['data'])} bytes instead of {wanted}")
        return np.frombuffer(sent["data"], dtype).reshape(shape).copy()
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProtocolError(f"An array cannot be read: {error}.") from error


def _read_image(sent: dict[Any, Any]) -> NDArray[Any]:
    if sent.get("format") == "raw":
        return _read_array(sent)
    if sent.get("format") not in _FORMATS:
        raise ProtocolError(
            f"An image has the format {shown(sent.get('format'))}. Valid: "
            f"{', '.join(_FORMATS)}."
        )
    try:
        pillow = import_module("PIL.Image")
    except ImportError as error:
        raise InvalidConfigError(
            "The package pillow is not installed; compressed images need it. Install "
            "it with: pip install pillow"
        ) from error
    try:
        image = pillow.open(io.BytesIO(sent["data"]), formats=("PNG", "JPEG"))
        # A small file may contain an image that exceeds all memory.
        if math.prod(image.size) > _LARGEST_IMAGE:
            raise ValueError(f"{image.width} x {image.height} pixels are too many")
        return np.array(image)
    except Exception as error:
        # Damaged files raise many kinds of exceptions.
        raise ProtocolError(f"An image cannot be read: {error}.") from error
