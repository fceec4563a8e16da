"""Words as numbers: those that training sees, and typing errors put right."""

from collections.abc import Iterable
from functools import lru_cache

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
        near = [
            (distance, known[0] != word[0], known)
            for known in self.words
            if abs(len(known) - len(word)) <= limit
            and len(known) >= _SHORTEST - 1
            and (distance := edit_distance(word, known)) <= limit
        ]
        return min(near)[2] if near else word


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
