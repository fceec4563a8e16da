"""English words: their meanings as vectors, and the numbers of those of training.

``scripts/make_word_vectors.py`` made the vectors, which training does not change:
all-MiniLM-L6-v2 on single words, in the space that the words of training span. There a
word that training never sees lies near those of a similar meaning, *beneath* near
*under*. Typing errors are put right.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files

import numpy as np

from lemma.core.poses import FloatArray
from lemma.policies.text.grammar import grammar
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.tasks.language.bank import vocabulary, words

PADDING = 0
"""Number of no word."""
UNKNOWN = 1
"""Number of every word that training never sees."""

_SHORT = 6
"""Letters of the longest word in which one error is put right, not two."""
_SHORTEST = 4
"""Letters of the shortest word that can be told from another real word."""
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


class Vocabulary:
    """The words that training sees, numbered from 2."""

    def __init__(self, english: Iterable[str] = ()) -> None:
        """Number the words of :func:`lemma.tasks.language.bank.vocabulary`.

        Args:
            english: Other words that are not taken for typing errors: ``"rod"`` is
                not ``"red"``.
        """
        self.words = tuple(sorted({*vocabulary(), *grammar().words}))
        self.numbers = {word: i for i, word in enumerate(self.words, UNKNOWN + 1)}
        self.colors = tuple(self.numbers[color] for color in BENCHMARK_COLORS)
        self._english = frozenset(english)
        long = [word for word in self.words if len(word) >= _SHORTEST - 1]
        self._long = tuple((word, _letters(word)) for word in long)
        self.corrected = lru_cache(maxsize=65536)(self._corrected)

    def __len__(self) -> int:
        """Return how many numbers there are, with padding and unknown."""
        return len(self.words) + UNKNOWN + 1

    def read(self, text: str) -> tuple[str, ...]:
        """Return the words of a text in lower case, typing errors put right."""
        return tuple(self.corrected(word) for word in words(text))

    def number(self, word: str) -> int:
        """Return the number of a word, ``UNKNOWN`` if training never sees it."""
        return self.numbers.get(word, UNKNOWN)

    def _corrected(self, word: str) -> str:
        if word in self.numbers or word in self._english:
            return word
        if len(word) < (_SHORTEST - 1 if self._english else _SHORTEST):
            return word
        limit = 1 if len(word) <= _SHORT else 2
        letters = _letters(word)
        near = [
            (distance, known[0] != word[0], known)
            for known, theirs in self._long
            # An error changes two letters at most; this is quickly seen.
            if (letters ^ theirs).bit_count() <= 2 * limit
            and abs(len(known) - len(word)) <= limit
            and (distance := edit_distance(word, known)) <= limit
        ]
        return min(near)[2] if near else word


def _letters(word: str) -> int:
    """Return the letters of a word as bits of a number."""
    found = 0
    for letter in word:
        found |= 1 << (ord(letter) & 31)
    return found


def edit_distance(a: str, b: str) -> int:
    """Return how many letters are added, left out, changed or swapped with the next."""
    before_last: list[int] = []
    last = list(range(len(b) + 1))
    for i in range(1, len(a) + 1):
        row = [i]
        for j in range(1, len(b) + 1):
            changed = last[j - 1] + (a[i - 1] != b[j - 1])
            cost = min(changed, last[j] + 1, row[j - 1] + 1)
            if i > 1 and j > 1 and a[i - 2 : i] == b[j - 2 : j][::-1]:
                cost = min(cost, before_last[j - 2] + 1)
            row.append(cost)
        before_last, last = last, row
    return last[-1]
