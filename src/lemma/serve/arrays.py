"""Arrays and views as messages, with the raw bytes of NumPy arrays."""

import math
from typing import Any, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import shown
from lemma.env.view import View
from lemma.serve.faults import ProtocolError

VIEW_ARRAYS = {
    "rgb": ("uint8", 3),
    "height_m": ("float32", 2),
    "coverage": ("bool", 2),
    "joints": ("float64", 2),
    "opening_m": ("float64", 1),
}
"""Data type and number of dimensions of every array of a view."""
ARRAY_TYPES = ("bool", "int8", "uint8", "int64", "float32", "float64")
"""Valid data types."""


class Array(msgspec.Struct):
    """An array in C order with little-endian numbers."""

    dtype: str
    shape: list[int]
    data: memoryview

    @classmethod
    def of(cls, array: NDArray[Any], dtype: str) -> Self:
        """Return an array as a message, converted to a data type."""
        plain = np.ascontiguousarray(array, np.dtype(dtype).newbyteorder("<"))
        return cls(dtype, list(plain.shape), memoryview(plain.tobytes()))

    def read(self, name: str) -> NDArray[Any]:
        """Return the array, read-only.

        Args:
            name: Name of the array, for error messages.

        Raises:
            ProtocolError: Type, shape and data do not match, or are not valid.
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
    """A view, with the number by which inputs on this connection refer to it."""

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
            ProtocolError: An array has a wrong type or shape, or is damaged.
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
