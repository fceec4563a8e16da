"""Random numbers that are hashed from counters on the device.

A CUDA graph replays the same kernels with the same arguments. Numbers that
differ between replays have to be in memory: here, the count of draws.
"""

import torch
from torch import Tensor

_32_BITS = 0xFFFFFFFF


class Draws:
    """Rows of uniform numbers, the same with and without a CUDA graph."""

    def __init__(self, worlds: int, columns: int, seed: int, device: str) -> None:
        """Make memory on the device; ``draw`` returns (worlds, columns)."""
        self._places = torch.arange(worlds * columns, device=device)
        self._shape = (worlds, columns)
        self.state = torch.zeros(2, dtype=torch.int64, device=device)
        """Seed, and how many draws there were."""
        self.seed(seed)

    def seed(self, seed: int) -> None:
        """Begin anew."""
        self.state[0] = seed & _32_BITS
        self.state[1] = 0

    def draw(self) -> Tensor:
        """Return the next whole numbers in [0, 2**32), (worlds, columns)."""
        self.state[1].add_(1)
        key = _mixed(_mixed(self.state[0]) + self.state[1])
        return _mixed(key + self._places).view(self._shape)


def uniform(numbers: Tensor) -> Tensor:
    """Return such numbers as fractions in [0, 1)."""
    return (numbers >> 8).float() * 2.0**-24


def _mixed(x: Tensor) -> Tensor:
    """Return a hash of 32 bits, in int64."""
    x = x & _32_BITS
    x = ((x ^ (x >> 16)) * 0x7FEB352D) & _32_BITS
    x = ((x ^ (x >> 15)) * 0x846CA68B) & _32_BITS
    return x ^ (x >> 16)
