"""Counter-based random numbers on the device.

A CUDA graph replays the same kernels with the same arguments. Values that differ
between replays must be in memory: here, the number of draws.
"""

import torch
from torch import Tensor

_32_BITS = 0xFFFFFFFF


class Draws:
    """Rows of uniform random numbers, equal with and without a CUDA graph."""

    def __init__(self, worlds: int, columns: int, seed: int, device: str) -> None:
        """Allocate the state on the device.

        Args:
            worlds: Number of rows of a draw.
            columns: Numbers in each row.
            seed: Seed.
            device: Device, such as ``"cuda:0"``.
        """
        self._places = torch.arange(worlds * columns, device=device)
        self._shape = (worlds, columns)
        self.state = torch.zeros(2, dtype=torch.int64, device=device)
        """Seed and number of draws."""
        self.seed(seed)

    def seed(self, seed: int) -> None:
        """Set the seed, and the number of draws to 0."""
        self.state[0] = seed & _32_BITS
        self.state[1] = 0

    def draw(self) -> Tensor:
        """Return the next whole numbers in [0, 2**32), (worlds, columns)."""
        self.state[1].add_(1)
        key = _mixed(_mixed(self.state[0]) + self.state[1])
        return _mixed(key + self._places).view(self._shape)


def uniform(numbers: Tensor) -> Tensor:
    """Return whole numbers of :meth:`Draws.draw` as fractions in [0, 1)."""
    return (numbers >> 8).float() * 2.0**-24


def _mixed(x: Tensor) -> Tensor:
    """Return a hash of 32 bits, in int64."""
    x = x & _32_BITS
    x = ((x ^ (x >> 16)) * 0x7FEB352D) & _32_BITS
    x = ((x ^ (x >> 15)) * 0x846CA68B) & _32_BITS
    return x ^ (x >> 16)
