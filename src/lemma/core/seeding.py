"""Named random streams: the same words always give the same numbers.

No module of this package touches a global random state. A stream is a pure function
of its words, so what one stream draws never shifts what another one draws.
"""

import hashlib

import numpy as np


def stream(*words: str | int) -> np.random.Generator:
    """Return the generator that belongs to ``words``.

    Args:
        *words: What the numbers are for, outermost first:
            ``stream("v2", "stack", "test", 3, "layout")``.

    Returns:
        A PCG64 generator seeded with the SHA-256 of the words.
    """
    text = "\x1f".join(str(word) for word in words)
    digest = hashlib.sha256(text.encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "big")))
