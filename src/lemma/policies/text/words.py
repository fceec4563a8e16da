"""Pretrained vectors of English words, and the vocabulary of training.

The vectors are fixed. ``scripts/make_word_vectors.py`` made them: all-MiniLM-L6-v2 on
single words, projected onto the span of the training vocabulary. There, a word that is
not in the training data is near words of similar meaning, such as *beneath* near
*under*. Typing errors are corrected.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files

import numpy as np

from lemma.core.poses import FloatArray
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.tasks.language.bank import vocabulary, words

PADDING = 0
"""Number of padding."""
UNKNOWN = 1
"""Number of all words outside of the training vocabulary."""

_SHORT = 6
"""Words up to this length may have one corrected error, longer ones two."""
_SHORTEST = 4
"""Shorter words are not corrected, because they may be other real words."""
NEAR = 0.4
"""Smallest cosine similarity of words with similar meaning."""
_OPPOSITES = {"above": "below"}
"""Words whose vector is near the training word of opposite meaning."""
_MOST = 12
"""Largest number of similar words for a word."""


@dataclass(frozen=True, eq=False)
class WordVectors:
    """English words, most of them with a vector."""

    words: tuple[str, ...]
    """All words of the list, sorted, with or without a vector."""
    rows: dict[str, int]
    """Row of the vectors for each word that has one."""
    vectors: FloatArray
    """(rows, D) float32 with norms up to 1; row 0 is zero, for words without a vector.
    The norm is smaller for words that are less related to the training vocabulary."""

    def row(self, word: str) -> int:
        """Return the row of a word, 0 if it has none."""
        return self.rows.get(word, 0)


@cache
def word_vectors() -> WordVectors:
    """Return the vectors of the package."""
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
    """Return English words that are similar to a word of the training vocabulary.

    None of them is in the training vocabulary, and for each this word is the closest
    one in it. So *top* does not replace *bottom*, although both are close.

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
    """Words with learned embeddings, numbered from 2: ``data/vocabulary.txt``.

    The list is frozen, because weights count its words. It has the words of the
    training templates and most of those of the rules. Words that rules got later are
    unknown ones, which have a pretrained vector at most.
    """

    def __init__(self, english: Iterable[str] = ()) -> None:
        """Number the words.

        Args:
            english: Other words that are no typing errors: ``"rod"`` does not become
                ``"red"``.
        """
        source = files("lemma.policies.text") / "data" / "vocabulary.txt"
        self.words = tuple(source.read_text(encoding="ascii").split())
        self.numbers = {word: i for i, word in enumerate(self.words, UNKNOWN + 1)}
        self.colors = tuple(self.numbers[color] for color in BENCHMARK_COLORS)
        self._english = frozenset(english)
        long = [word for word in self.words if len(word) >= _SHORTEST - 1]
        self._long = tuple((word, _letters(word)) for word in long)
        self.corrected = lru_cache(maxsize=65536)(self._corrected)

    def __len__(self) -> int:
        """Return the size of the vocabulary, including padding and unknown."""
        return len(self.words) + UNKNOWN + 1

    def read(self, text: str) -> tuple[str, ...]:
        """Return the words of a text in lower case, with typing errors corrected."""
        return tuple(self.corrected(word) for word in words(text))

    def number(self, word: str) -> int:
        """Return the number of a word, ``UNKNOWN`` outside of the vocabulary."""
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
            # A fast pre-check: an error changes at most two letters.
            if (letters ^ theirs).bit_count() <= 2 * limit
            and abs(len(known) - len(word)) <= limit
            and (distance := edit_distance(word, known)) <= limit
        ]
        return min(near)[2] if near else word


def _letters(word: str) -> int:
    """Return the set of letters of a word as a bit mask."""
    found = 0
    for letter in word:
        found |= 1 << (ord(letter) & 31)
    return found


def edit_distance(a: str, b: str) -> int:
    """Return the edit distance of two words, with swaps of neighboring letters."""
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
