"""Texts as rows of numbers: words, marks, and which names are of one color.

With names, colors of things are no words. All of them are the same token, and a row
says besides which of them are one color, so that what is learned of red holds for all.
Things that come in one color only are found by their nouns.
"""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lemma.policies.entities import EntitySet
from lemma.policies.text.vocabulary import PADDING, UNKNOWN, Vocabulary
from lemma.policies.text.word_vectors import word_vectors
from lemma.scene.objects.entity import entity_named

NO_NAME = -1
_PIECE = re.compile(r"[a-z]+(?:['-][a-z]+)*|\d|<?[-=]+>?|[.,;:?!/()+&@>]")
_MARKS = {
    **dict.fromkeys(".?!", 0),
    **dict.fromkeys(",;", 1),
    **dict.fromkeys(":", 2),
    **dict.fromkeys("0123456789()", 3),
}
_ARROW, _BACK = 4, 5
_KINDS_OF_MARKS = 6
_REMEMBERED = 100_000


class Sentences(NamedTuple):
    """Several sentences, padded behind to one length L."""

    numbers: Tensor
    """Number of each word, (B, L) int64."""
    rows: Tensor
    """Row of its vector, (B, L) int64; 0 for none."""
    names: Tensor
    """Group of entities that it may name, (B, L) int64; -1 for none."""

    @property
    def mask(self) -> Tensor:
        """Where words are, (B, L) bool."""
        return self.numbers != PADDING


def groups_of(entities: EntitySet) -> tuple[list[int], dict[str, int]]:
    """Return the group of each entity but the stick, and each group's words.

    Things of one color are a group; what has no color is one of its own.
    """
    groups: list[int] = []
    numbers: dict[str, int] = {}
    told: dict[str, int] = {}
    for name in entities.names[: entities.stick]:
        entity = entity_named(name)
        group = numbers.setdefault(entity.color or name, len(numbers))
        groups.append(group)
        told |= dict.fromkeys([entity.color or entity.kind.nouns[0]], group)
    return groups, told


class SentenceReader:
    """Turns texts into numbers; typing errors are put right."""

    def __init__(self, longest: int, entities: EntitySet | None = None) -> None:
        """Read the vocabulary.

        Args:
            longest: Words behind these are not read.
            entities: Things that may be named. Without them there are words alone: no
                marks and no names; and a text without words is one unknown word.
        """
        self.groups = groups_of(entities)[1] if entities else None
        self.longest = longest
        self.vocabulary = Vocabulary(word_vectors().words)
        self.name = len(self.vocabulary) + _KINDS_OF_MARKS
        self._known: dict[str, list[tuple[int, int, int]]] = {}

    def __len__(self) -> int:
        """Return how many numbers there are."""
        return len(self.vocabulary) if self.groups is None else self.name + 1

    def read(self, texts: Sequence[str], device: torch.device) -> Sentences:
        """Return texts as numbers; with names, one without words is padding alone."""
        told = torch.tensor([self._read(text) for text in texts])
        if device.type == "cpu":
            # Elsewhere one shape for all is faster than a small one.
            longest = max(1, int((told[..., 0] != PADDING).sum(1).max()))
            told = told[:, :longest]
        return Sentences(*told.to(device).unbind(2))

    def _read(self, text: str) -> list[tuple[int, int, int]]:
        found = self._known.get(text)
        if found is None:
            found = list(self._words(text))[: self.longest]
            if not found and self.groups is None:
                found = [(UNKNOWN, 0, NO_NAME)]
            found += [(PADDING, 0, NO_NAME)] * (self.longest - len(found))
            if len(self._known) < _REMEMBERED:
                self._known[text] = found
        return found

    def _words(self, text: str) -> Iterator[tuple[int, int, int]]:
        """Yield number, row of its vector and group of each word of a text."""
        if self.groups is None:
            yield from map(self._word, self.vocabulary.read(text))
            return
        for piece in _PIECE.findall(text.lower()):
            if not piece[0].isalpha():
                back = piece.startswith("<")
                mark = _MARKS.get(piece, _BACK if back else _ARROW)
                yield len(self.vocabulary) + mark, 0, NO_NAME
                continue
            words = [piece] if piece in self.groups else self.vocabulary.read(piece)
            for word in words:
                group = self.groups.get(word)
                yield self._word(word) if group is None else (self.name, 0, group)

    def _word(self, word: str) -> tuple[int, int, int]:
        return self.vocabulary.number(word), word_vectors().row(word), NO_NAME
