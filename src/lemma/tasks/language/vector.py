"""A sentence as numbers, for policies that read vectors and no text.

LeRobot's ACT and Diffusion Policy take ``observation.environment_state``; most
instances cannot be told apart without their sentence.
"""

import hashlib
import math

import numpy as np
import numpy.typing as npt

from lemma.tasks.language.bank import words

WORDS = 40
"""Largest number of words; later ones are dropped."""
WIDTH = 24
"""Numbers of each word."""
NUMBERS = WORDS * WIDTH
"""Numbers of a sentence."""


def sentence_vector(sentence: str) -> npt.NDArray[np.float32]:
    """Return the words of a sentence, one after the other, as signs.

    A word is a fixed corner of a cube of length one, taken from its SHA-256: words have
    nothing to do with one another, nothing is learned, and no file is needed. Behind
    the last word are zeros.

    Returns:
        (NUMBERS,).
    """
    found = np.zeros((WORDS, WIDTH), np.float32)
    for row, word in zip(found, words(sentence), strict=False):
        row[:] = _corner(word)
    return found.ravel()


def _corner(word: str) -> npt.NDArray[np.float32]:
    digest = hashlib.sha256(word.encode()).digest()[: WIDTH // 8]
    bits = np.unpackbits(np.frombuffer(digest, np.uint8))
    return (bits.astype(np.float32) * 2.0 - 1.0) / math.sqrt(WIDTH)
