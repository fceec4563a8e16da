"""How messages travel over a socket: msgpack, with arrays as raw bytes."""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.serve.protocol.faults import ProtocolError
from lemma.serve.protocol.messages import Message

DTYPES = ("bool", "uint8", "int32", "int64", "float32", "float64")
"""Types of arrays that may travel."""
LARGEST_BYTES = 1 << 30
"""Largest message."""

_KEYS = {"dtype", "shape", "data"}


def pack(message: Message) -> bytes:
    """Return a message as bytes.

    An array becomes ``{"dtype": name, "shape": [...], "data": bytes}``: little-endian,
    last index fastest.
    """
    packed: bytes = _msgpack().packb(message, default=_plain)
    return packed


def unpack(data: bytes | str) -> Message:
    """Return the message that :func:`pack` packed; its arrays are read-only.

    Raises:
        ProtocolError: The bytes are none.
    """
    if isinstance(data, str):
        raise ProtocolError("Messages are binary frames of msgpack, not text.")
    try:
        message = _msgpack().unpackb(data, object_hook=_array, strict_map_key=False)
    except ProtocolError:
        raise
    except Exception as error:
        # Every version of the package has exceptions of its own for this.
        raise ProtocolError(f"A message is no msgpack: {error}.") from error
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise ProtocolError("A message is a map with a type; this one is not.")
    return message


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and value.dtype.name in DTYPES:
        array = np.ascontiguousarray(value)
        if array.dtype.byteorder == ">" or sys.byteorder == "big":
            array = array.astype(array.dtype.newbyteorder("<"))
        return {
            "dtype": array.dtype.name,
            "shape": list(value.shape),
            "data": array.tobytes(),
        }
    raise ProtocolError(f"A {type(value).__name__} cannot be sent.")


def _array(data: dict[Any, Any]) -> Any:
    if data.keys() != _KEYS:
        return data
    name, shape, raw = data["dtype"], data["shape"], data["data"]
    if name not in DTYPES:
        raise ProtocolError(f"An array is of type {name!r}; valid: {DTYPES}.")
    try:
        return np.frombuffer(raw, np.dtype(name).newbyteorder("<")).reshape(shape)
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"An array cannot be read: {error}.") from error


def _msgpack() -> ModuleType:
    return extra_package("msgpack")


def extra_package(name: str) -> ModuleType:
    """Import a package of the extra ``serve``, or one of its modules.

    Raises:
        InvalidConfigError: It is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InvalidConfigError(
            f"The package {name.partition('.')[0]} is not installed, without which "
            "policies cannot be reached over a socket. Install it with: pip install "
            "'lemma-bench[serve]'"
        ) from error
