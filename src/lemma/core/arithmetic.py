"""Sums that have the same bits on every Python."""

from collections.abc import Iterable


def ordered_sum(values: Iterable[float]) -> float:
    """Return the sum of numbers, added one after the other from the first on.

    Since Python 3.12 the built-in ``sum`` compensates for rounding when it adds floats,
    so its last bits differ from those of Python 3.11. Whatever reaches the simulation
    uses this function instead.
    """
    total = 0.0
    for value in values:
        total += value
    return total
