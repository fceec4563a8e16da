"""Encoding of English texts as tokens for the networks.

A text is rows of numbers: words, punctuation, and groups of names of the same color. If
a reader has names, all colors of entities are the same token, and the group tells the
colors apart, so that training on one color generalises to all. Entities that exist in
one color only are recognised by their nouns.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from lemma.core.arguments import Count, Depth, Share, Width
from lemma.policies.entities import EntitySet
from lemma.policies.layers import TransformerLayer, sent, sinusoids
from lemma.policies.text.words import PADDING, UNKNOWN, Vocabulary, word_vectors
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import entity_named
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.palette import BENCHMARK_COLORS

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
_MOST = "most"


class Sentences(NamedTuple):
    """B sentences, padded at the end to the same length L."""

    numbers: Tensor
    """Number of each word, (B, L) int64."""
    rows: Tensor
    """Row of each word in the pretrained vectors, (B, L) int64; 0 for none."""
    names: Tensor
    """Group of entities that each word may name, (B, L) int64; -1 for none."""

    @property
    def mask(self) -> Tensor:
        """True for words, False for padding, (B, L) bool."""
        return self.numbers != PADDING


def sentences_of(rows: NDArray[np.int32], device: torch.device) -> Sentences:
    """Return sentences on a device.

    Args:
        rows: Number, row of its vector and group of each word, (B, longest, 3).
        device: Device of the result.
    """
    numbers = torch.from_numpy(rows.astype(np.int64))
    if device.type == "cpu":
        # On a GPU a fixed shape is faster than short sentences.
        longest = max(1, int((numbers[..., 0] != PADDING).sum(1).max()))
        numbers = numbers[:, :longest]
    return Sentences(*sent(numbers, device).unbind(2))


Texts = Sequence[str] | Sentences
"""Texts, or texts that a :class:`SentenceReader` has converted."""


def groups_of(entities: EntitySet) -> tuple[list[int], dict[str, int]]:
    """Return the group of each entity except the stick, and the group of each word.

    Entities of one color are a group; each entity without color is its own group.
    """
    groups: list[int] = []
    numbers: dict[str, int] = {}
    by_word: dict[str, int] = {}
    for name in entities.names[: entities.stick]:
        entity = entity_named(name)
        group = numbers.setdefault(entity.color or name, len(numbers))
        groups.append(group)
        by_word |= dict.fromkeys([entity.color or entity.kind.nouns[0]], group)
    return groups, by_word


Numbers = tuple[int, int, int]
"""Number of a word, row of its vector, and group of entities that it may name."""


class SentenceReader:
    """Converts texts to numbers and corrects typing errors."""

    def __init__(self, longest: int, entities: EntitySet | None = None) -> None:
        """Read the vocabulary.

        Args:
            longest: Largest number of words; later words are not read.
            entities: Entities that texts may name. If None, only words are read, no
                punctuation and no names, and a text without words is one unknown word.
        """
        self.groups = groups_of(entities)[1] if entities else None
        self.longest = longest
        self.vocabulary = Vocabulary(word_vectors().words)
        self.name = len(self.vocabulary) + _KINDS_OF_MARKS
        self._known: dict[str, NDArray[np.int32]] = {}
        self._numbers = lru_cache(maxsize=_REMEMBERED)(self._numbers_of)

    def __len__(self) -> int:
        """Return the size of the vocabulary."""
        return len(self.vocabulary) if self.groups is None else self.name + 1

    def read(self, texts: Texts, device: torch.device) -> Sentences:
        """Return texts as numbers; with names, a text without words is all padding."""
        if isinstance(texts, Sentences):
            return texts
        return sentences_of(self.rows(texts), device)

    def rows(self, texts: Sequence[str]) -> NDArray[np.int32]:
        """Return number, row of its vector and group of each word, (B, longest, 3)."""
        return np.stack([self._read(text) for text in texts])

    def _read(self, text: str) -> NDArray[np.int32]:
        """Return number, row of its vector and group of each word, (longest, 3)."""
        found = self._known.get(text)
        if found is None:
            said = list(self._words(text))[: self.longest]
            if not said and self.groups is None:
                said = [(UNKNOWN, 0, NO_NAME)]
            said += [(PADDING, 0, NO_NAME)] * (self.longest - len(said))
            found = np.array(said, np.int32)
            if len(self._known) < _REMEMBERED:
                self._known[text] = found
        return found

    def _words(self, text: str) -> Iterator[Numbers]:
        if self.groups is None:
            yield from map(self._word, self.vocabulary.read(text))
            return
        for piece in _PIECE.findall(resolved(text).lower()):
            yield from self._numbers(piece)

    def _numbers_of(self, piece: str) -> tuple[Numbers, ...]:
        """Return the words of a piece, or its mark."""
        assert self.groups is not None
        if not piece[0].isalpha():
            back = piece.startswith("<")
            mark = _MARKS.get(piece, _BACK if back else _ARROW)
            return ((len(self.vocabulary) + mark, 0, NO_NAME),)
        words = [piece] if piece in self.groups else self._parts(piece)
        groups = ((word, self.groups.get(word)) for word in words)
        return tuple(
            self._word(word) if group is None else (self.name, 0, group)
            for word, group in groups
        )

    def _parts(self, piece: str) -> Sequence[str]:
        """Return the words of a piece; "leftmost", which has no vector, is two."""
        found, stem = self.vocabulary.read(piece), piece.removesuffix(_MOST)
        known = any(self._word(word)[:2] != (UNKNOWN, 0) for word in found)
        return found if known or stem in ("", piece) else (stem, _MOST)

    def _word(self, word: str) -> Numbers:
        return self.vocabulary.number(word), word_vectors().row(word), NO_NAME


TextKind = Literal["words", "words+vectors"]
"""Kinds of text encoders."""


@dataclass(frozen=True)
class TextConfig:
    """Options of a :class:`TextEncoder`."""

    kind: TextKind = "words"
    """``words``: learned embeddings of the words that training sees.
    ``words+vectors``: with pretrained vectors of many more words added."""
    width: Width = 256
    """Width of a token."""
    layers: Depth = 2
    """Transformer layers over the words."""
    heads: Depth = 4
    """Number of heads of the attention."""
    max_words: Count = 40
    """Largest number of words; later words are not read."""
    dropout: Share = 0.1
    """Probability of dropout in training."""
    word_dropout: Share = 0.1
    """Share of words that are replaced by the unknown word in training; never colors of
    objects."""
    embedding_dropout: Share = 0.5
    """Share of words without their learned embedding in training, so that the model
    learns to use the pretrained vectors; only for words+vectors, and never for
    colors."""


class WordEmbedding(nn.Module):
    """One token per word: a learned embedding and, optionally, a pretrained vector."""

    vectors: Tensor

    def __init__(self, sentences: SentenceReader, width: int, *, meaning: bool) -> None:
        """Make the weights.

        Args:
            sentences: Reader with the vocabulary.
            width: Width of a token.
            meaning: Whether to add pretrained vectors.
        """
        super().__init__()
        self.sentences = sentences
        self.embedding = nn.Embedding(len(sentences), width, PADDING)
        nn.init.normal_(self.embedding.weight, std=0.5)
        self.meaning: nn.Linear | None = None
        if meaning:
            vectors = torch.from_numpy(word_vectors().vectors).float()
            self.register_buffer("vectors", vectors, persistent=False)
            self.meaning = nn.Linear(vectors.shape[1], width, bias=False)
            nn.init.normal_(self.meaning.weight, std=0.5)

    def embedded(self, sentences: Sentences, dropped: Tensor, bare: Tensor) -> Tensor:
        """Return a token for each word, (B, L, width).

        Args:
            sentences: The words.
            dropped: Words to treat as unknown, (B, L) bool.
            bare: Words without their learned embedding, (B, L) bool.
        """
        learned: Tensor = self.embedding(
            sentences.numbers.masked_fill(dropped | bare, UNKNOWN)
        )
        if self.meaning is None:
            return learned
        vectors: Tensor = self.meaning(self.vectors[sentences.rows])
        return vectors.masked_fill(dropped.unsqueeze(2), 0.0) + learned

    def drawn(self, spared: Tensor, share: float) -> Tensor:
        """Draw the words to drop in training, (B, L) bool; none at inference.

        Args:
            spared: Words that are never dropped, (B, L) bool.
            share: Share of the other words to drop.
        """
        if not (self.training and share):
            return torch.zeros_like(spared)
        return (torch.rand(spared.shape, device=spared.device) < share) & ~spared


class TextEncoder(WordEmbedding):
    """Turns sentences into tokens, on the device of its weights."""

    known: Tensor
    places: Tensor

    def __init__(self, config: TextConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        config = config or TextConfig()
        sentences = SentenceReader(config.max_words)
        meaning = config.kind == "words+vectors"
        super().__init__(sentences, config.width, meaning=meaning)
        self.config = config
        always = torch.zeros(len(sentences), dtype=torch.bool)
        always[[PADDING, *sentences.vocabulary.colors]] = True
        self.register_buffer("known", always, persistent=False)
        places = sinusoids(config.max_words, config.width)
        self.register_buffer("places", places, persistent=False)
        self.layers = nn.ModuleList(
            TransformerLayer(
                config.width, config.heads, 2 * config.width, config.dropout
            )
            for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(config.width)

    def encode(self, texts: Texts) -> tuple[Tensor, Tensor]:
        """Return tokens (B, L, width), and the mask of words, (B, L) bool.

        Each row has at least one word: a text without words is one unknown word.

        Args:
            texts: One per row; upper case, punctuation and typing errors are allowed.
        """
        sentences = self.sentences.read(texts, self.places.device)
        mask, spared = sentences.mask, self.known[sentences.numbers]
        dropped = bare = self.drawn(spared, self.config.word_dropout)
        if self.meaning is not None:
            bare = self.drawn(spared, self.config.embedding_dropout)
        tokens = self.embedded(sentences, dropped, bare) + self.places[: mask.shape[1]]
        for layer in self.layers:
            tokens = layer(tokens, mask.unsqueeze(1))
        return self.norm(tokens), mask

    def pooled(self, texts: Texts) -> Tensor:
        """Return one vector per text, (B, width): the mean of its tokens."""
        tokens, mask = self.encode(texts)
        weights = mask.unsqueeze(2).to(tokens.dtype)
        return (tokens * weights).sum(1) / weights.sum(1)


_COLORS_NAMED = re.compile(r"\b(?:" + "|".join(BENCHMARK_COLORS) + r")\b")
_NOUN = "|".join(sorted({*CUBE.nouns, *PAD.nouns, "mat", "disc", "brick", "spot"}))
_SAME = r"(?:its|the|that|their) (?:very )?(?:own|same|very)(?: own)? colou?r"
_OWN = re.compile(
    rf"\bthe (?P<noun>{_NOUN})"
    rf" (?:(?:of|in|with|having) (?:{_SAME}|its colou?r)"
    r"|(?:that|which) (?:has|shares|matches) (?:its|the same)(?: own)? colou?r)"
    rf"|\b(?:the|its) (?:matching|same[- ]colou?red|like-colou?red) (?P<noun2>{_NOUN})",
    re.IGNORECASE,
)


def resolved(text: str) -> str:
    """Replace phrases such as "the pad of its own color" by the name of the color.

    Only texts with exactly one color are changed; in others the phrase is ambiguous.
    """
    colors = set(_COLORS_NAMED.findall(text.lower()))
    if len(colors) != 1:
        return text
    color = colors.pop()
    return _OWN.sub(lambda m: f"the {color} {m['noun'] or m['noun2']}", text)
