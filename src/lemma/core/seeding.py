"""Named random streams and ordered sums, with the same results on every machine.

No module of this package uses a global random state. A stream is a pure function of its
words, so draws from one stream never affect another.
"""

import hashlib
from collections.abc import Iterable

import numpy as np


def stream(*words: str | int) -> np.random.Generator:
    """Return the random generator of a sequence of words.

    Args:
        *words: Purpose of the numbers, outermost scope first, such as
            ``stream("v3", "stack", "test", 3, "layout")``.

    Returns:
        A PCG64 generator seeded with the SHA-256 of the words.
    """
    text = "\x1f".join(str(word) for word in words)
    digest = hashlib.sha256(text.encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "big")))


def ordered_sum(values: Iterable[float]) -> float:
    """Return the sum of numbers, added in order.

    Since Python 3.12 the built-in ``sum`` compensates for rounding when it adds floats,
    so its last bits differ from those of Python 3.11. The simulation uses this function
    instead.
    """
    total = 0.0
    for value in values:
        total += value
    return total
