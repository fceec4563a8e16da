"""A sentence as a vector, for policies without text input.

LeRobot's ACT and Diffusion Policy read ``observation.environment_state``. Without their
sentence, most instances are ambiguous.
"""

import hashlib
import math

import numpy as np
import numpy.typing as npt

from lemma.tasks.language.bank import words

WORDS = 40
"""Largest number of words; further ones are dropped."""
WIDTH = 24
"""Components of the vector of a word."""
NUMBERS = WORDS * WIDTH
"""Components of the vector of a sentence."""


def sentence_vector(sentence: str) -> npt.NDArray[np.float32]:
    """Return the concatenated vectors of the words of a sentence.

    The vector of a word is a vector of signs from its SHA-256, scaled to unit length.
    It needs neither training nor a file, and different words are unrelated. Zeros
    follow the last word.

    Returns:
        Shape (NUMBERS,).
    """
    found = np.zeros((WORDS, WIDTH), np.float32)
    for row, word in zip(found, words(sentence), strict=False):
        row[:] = _corner(word)
    return found.ravel()


def _corner(word: str) -> npt.NDArray[np.float32]:
    digest = hashlib.sha256(word.encode()).digest()[: WIDTH // 8]
    bits = np.unpackbits(np.frombuffer(digest, np.uint8))
    return (bits.astype(np.float32) * 2.0 - 1.0) / math.sqrt(WIDTH)
