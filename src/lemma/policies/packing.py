"""Weights of a published file, in about seven bits each.

Large matrices and kernels are rounded to whole multiples of a step and the multiples
are stored with a Huffman code; everything else stays in 16 bits. Steps are shares of a
tensor's standard deviation. Poses hang on small matrices and kernels, at the ends of a
network and at its highest resolution, which are rounded more finely; kernels of many
channels, which hold most of the weights, see coarse maps.
"""

import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_LEAST = 1024
"""Tensors with fewer values, and vectors, are not rounded."""
_LARGEST = 2**15 - 1
_LARGEST_STEP = float(np.finfo(np.float32).max) / (_LARGEST + 1)
"""Values of larger ones would overflow."""


class PackingError(ValueError):
    """Packed weights that cannot be unpacked."""


@dataclass(frozen=True)
class Fineness:
    """How finely a model is rounded: in steps in a tensor's standard deviation."""

    coarse: float
    """Steps of large tensors; 32 make about 7 bits."""
    fine: float = 512.0
    """Steps of others; 512 make 11 bits, 2048 make 13."""
    small: int = 32_768
    """Tensors with fewer values are none of the large ones."""
    only: str = ""
    """Expression that the names of large ones begin with; any if empty."""


@dataclass(frozen=True)
class Rounding:
    """How one tensor was rounded."""

    shape: tuple[int, ...]
    step: float
    """Value of the whole number 1."""


def pack(
    weights: Mapping[str, Tensor], fineness: Fineness
) -> tuple[dict[str, Tensor], dict[str, Rounding]]:
    """Return tensors to be written, and how those that are packed were rounded.

    Args:
        weights: By name; floating-point ones are rounded.
        fineness: How finely.
    """
    packed, roundings = {}, {}
    for name, value in weights.items():
        if not value.is_floating_point() or value.ndim < 2 or value.numel() < _LEAST:
            packed[name] = value.half() if value.is_floating_point() else value
            continue
        exact = value.double()
        large = value.numel() >= fineness.small and re.match(fineness.only, name)
        steps = fineness.coarse if large else fineness.fine
        step = max(float(exact.std()) / steps, float(exact.abs().max()) / _LARGEST)
        if not 0.0 < step < math.inf:
            packed[name] = value.half()
            continue
        numbers = torch.round(exact / step).to(torch.int32).numpy()
        packed[name] = torch.frombuffer(_coded(numbers.reshape(-1)), dtype=torch.uint8)
        roundings[name] = Rounding(tuple(value.shape), step)
    return packed, roundings


def unpack(coded: Tensor, rounding: Rounding) -> Tensor:
    """Return the values of a packed tensor, float32.

    It takes no more memory than the shape needs, even for damaged codes.

    Args:
        coded: (bytes,) uint8.
        rounding: How it was rounded.

    Raises:
        PackingError: The code is not that of such a tensor.
    """
    if not 0.0 < rounding.step < _LARGEST_STEP:
        raise PackingError(f"a step of {rounding.step}")
    if coded.dtype != torch.uint8 or coded.ndim != 1:
        raise PackingError(f"{coded.dtype} of shape {tuple(coded.shape)} is no code")
    numbers = _decoded(coded.numpy().tobytes(), math.prod(rounding.shape))
    values = torch.from_numpy(numbers.astype(np.float32) * np.float32(rounding.step))
    return values.view(rounding.shape)


def _coded(numbers: NDArray[np.int32]) -> bytearray:
    """Return whole numbers of 16 bits as a Huffman code of their bytes."""
    # Small numbers of either sign become small ones without: 0, -1, 1, -2, 2 ...
    folded = ((numbers << 1) ^ (numbers >> 31)).astype(np.uint16)
    planes = (folded & 0xFF).astype(np.uint8), (folded >> 8).astype(np.uint8)
    # Low bytes are noise, for which matches are not searched; most high ones are zero.
    strategies = zlib.Z_HUFFMAN_ONLY, zlib.Z_DEFAULT_STRATEGY
    coded = bytearray()
    for plane, strategy in zip(planes, strategies, strict=True):
        coder = zlib.compressobj(9, zlib.DEFLATED, 15, 9, strategy)
        coded += coder.compress(plane.tobytes()) + coder.flush()
    return coded


def _decoded(coded: bytes, count: int) -> NDArray[np.int32]:
    planes = []
    for _ in range(2):
        decoder = zlib.decompressobj()
        try:
            found = decoder.decompress(coded, count + 1)
        except zlib.error as error:
            raise PackingError(str(error)) from error
        if len(found) != count:
            raise PackingError(f"{len(found)} values or more instead of {count}")
        planes.append(np.frombuffer(found, np.uint8).astype(np.int32))
        # Empty where the code is cut off, or goes on behind its end.
        coded = decoder.unconsumed_tail or decoder.unused_data
    folded = planes[0] | (planes[1] << 8)
    numbers: NDArray[np.int32] = (folded >> 1) ^ -(folded & 1)
    return numbers
