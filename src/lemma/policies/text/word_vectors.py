"""Meanings of English words: vectors made beforehand, which training does not change.

``scripts/make_word_vectors.py`` made them: all-MiniLM-L6-v2 on single words, in the
space that the words of training span. There a word that training never sees lies near
those of a similar meaning, *beneath* near *under*.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from lemma.core.poses import FloatArray
from lemma.tasks.language.bank import vocabulary

NEAR = 0.4
"""Cosine of the angle between words of similar meaning, at least."""
_OPPOSITES = {"above": "below"}
"""Words that are near the word of training that means their opposite."""
_MOST = 12
"""Words that are offered in another's place."""


@dataclass(frozen=True, eq=False)
class WordVectors:
    """English words, the most of them with a vector."""

    words: tuple[str, ...]
    """All words of the list, sorted, with or without a vector."""
    rows: dict[str, int]
    """Row of the vectors for each word that has one."""
    vectors: FloatArray
    """(rows, D) float32, no longer than 1; row 0 is all zero, for other words. The
    shorter, the less a word has to do with those of training."""

    def row(self, word: str) -> int:
        """Return the row of a word, 0 if it has none."""
        return self.rows.get(word, 0)


@cache
def word_vectors() -> WordVectors:
    """Return the vectors that come with the package."""
    source = files("lemma.policies.text") / "data" / "word_vectors.npz"
    with source.open("rb") as file, np.load(file) as data:
        words = tuple(bytes(data["words"]).decode("ascii").split("\n"))
        numbers = data["numbers"]
        vectors = data["vectors"].astype(np.float32) * data["scale"].astype(np.float32)
    return WordVectors(
        words,
        {words[number]: row for row, number in enumerate(numbers, 1)},
        np.concatenate([np.zeros_like(vectors[:1]), vectors]),
    )


def neighbours(word: str) -> tuple[str, ...]:
    """Return English words that mean much the same as a word of training.

    None of them is seen in training, and each is closer to this word than to any
    other that is: *top* and *bottom* are near, yet neither stands for the other.

    Args:
        word: In lower case.
    """
    return _neighbours().get(word, ())


@cache
def _neighbours() -> dict[str, tuple[str, ...]]:
    table = word_vectors()
    known = [word for word in vocabulary() if word in table.rows]
    anchors = table.vectors[[table.rows[word] for word in known]]
    cosines = table.vectors @ anchors.T
    closest = cosines.argmax(1)
    found: dict[str, list[tuple[float, str]]] = {}
    for word, row in table.rows.items():
        cosine = float(cosines[row, closest[row]])
        other = known[closest[row]]
        opposite = other == _OPPOSITES.get(word)
        if word not in known and cosine >= NEAR and not opposite:
            found.setdefault(other, []).append((-cosine, word))
    return {
        word: tuple(near for _, near in sorted(others)[:_MOST])
        for word, others in found.items()
    }
