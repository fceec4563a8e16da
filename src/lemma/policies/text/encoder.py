"""Text as tokens for the networks: plain English in, vectors out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from lemma.core.arguments import Count, Depth, Share, Width
from lemma.policies.layers import TransformerLayer, sinusoids
from lemma.policies.text.vocabulary import PADDING, UNKNOWN, Vocabulary
from lemma.policies.text.word_vectors import word_vectors

TextKind = Literal["words", "words+vectors"]
"""Kinds of encoders."""
_REMEMBERED = 100_000
"""Texts whose numbers are kept."""


@dataclass(frozen=True)
class TextConfig:
    """Options of a :class:`TextEncoder`."""

    kind: TextKind = "words"
    """``words``: learned embeddings of the words that training sees.
    ``words+vectors``: with pretrained vectors of many more words added."""
    width: Width = 256
    """Of a token."""
    layers: Depth = 2
    """Transformer layers over the words."""
    heads: Depth = 4
    """Of the attention."""
    max_words: Count = 40
    """Words behind these are not read."""
    dropout: Share = 0.1
    """Share of values that are left out in training."""
    word_dropout: Share = 0.1
    """Share of words that are unknown in training; colors of objects always are
    known, because nothing else could tell them."""
    embedding_dropout: Share = 0.5
    """Share of words whose learned embedding is left out in training, so that their
    vectors must do; of ``words+vectors`` only, and never of colors."""


class TextEncoder(nn.Module):
    """Turns sentences into tokens, on the device of its weights."""

    def __init__(self, config: TextConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        super().__init__()
        self.config = config = config or TextConfig()
        self.reader = _Words(config)

    def encode(self, texts: Sequence[str]) -> tuple[Tensor, Tensor]:
        """Return tokens (B, L, width), and which of them are words, (B, L) bool.

        There is at least one: a text without words is one unknown word.

        Args:
            texts: One per row; upper case, punctuation and typing errors are fine.
        """
        tokens, mask = self.reader(texts)
        return tokens, mask

    def pooled(self, texts: Sequence[str]) -> Tensor:
        """Return one vector per text, (B, width): the mean of its tokens."""
        tokens, mask = self.encode(texts)
        weights = mask.unsqueeze(2).to(tokens.dtype)
        return (tokens * weights).sum(1) / weights.sum(1)

    def forward(self, texts: Sequence[str]) -> tuple[Tensor, Tensor]:
        """Encode; see :meth:`encode`."""
        return self.encode(texts)


class _Words(nn.Module):
    """One token per word, and a transformer over them."""

    known: Tensor
    places: Tensor
    vectors: Tensor

    def __init__(self, config: TextConfig) -> None:
        super().__init__()
        self.config = config
        self.vocabulary = Vocabulary(word_vectors().words)
        self.embedding = nn.Embedding(len(self.vocabulary), config.width, PADDING)
        nn.init.normal_(self.embedding.weight, std=0.5)
        always = torch.zeros(len(self.vocabulary), dtype=torch.bool)
        always[[PADDING, *self.vocabulary.colors]] = True
        self.register_buffer("known", always, persistent=False)
        places = sinusoids(config.max_words, config.width)
        self.register_buffer("places", places, persistent=False)
        self.meaning: nn.Linear | None = None
        if config.kind == "words+vectors":
            vectors = torch.from_numpy(word_vectors().vectors).float()
            self.register_buffer("vectors", vectors, persistent=False)
            self.meaning = nn.Linear(vectors.shape[1], config.width, bias=False)
            nn.init.normal_(self.meaning.weight, std=0.5)
        self.layers = nn.ModuleList(
            TransformerLayer(
                config.width, config.heads, 2 * config.width, config.dropout
            )
            for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(config.width)
        self._numbers: dict[str, list[tuple[int, int]]] = {}

    def forward(self, texts: Sequence[str]) -> tuple[Tensor, Tensor]:
        both = torch.tensor([self._read(text) for text in texts])
        numbers, rows = both.to(self.places.device).unbind(2)
        mask = numbers != PADDING
        if mask.device.type == "cpu":
            # Elsewhere one shape for all is faster than a small one.
            longest = int(mask.sum(1).max())
            numbers, rows, mask = (x[:, :longest] for x in (numbers, rows, mask))
        dropped = self._drawn(numbers, self.config.word_dropout)
        tokens = self.places[: numbers.shape[1]]
        learned = dropped
        if self.meaning is not None:
            vectors = self.meaning(self.vectors[rows])
            tokens = tokens + vectors.masked_fill(dropped.unsqueeze(2), 0.0)
            learned = dropped | self._drawn(numbers, self.config.embedding_dropout)
        tokens = tokens + self.embedding(numbers.masked_fill(learned, UNKNOWN))
        for layer in self.layers:
            tokens = layer(tokens, mask.unsqueeze(1))
        return self.norm(tokens), mask

    def _drawn(self, numbers: Tensor, share: float) -> Tensor:
        """Return which words are left out, like ``numbers``: none but in training."""
        if not (self.training and share):
            return torch.zeros_like(numbers, dtype=torch.bool)
        drawn = torch.rand(numbers.shape, device=numbers.device) < share
        return drawn & ~self.known[numbers]

    def _read(self, text: str) -> list[tuple[int, int]]:
        """Return each word's number and the row of its vector, padded."""
        found = self._numbers.get(text)
        if found is None:
            read = self.vocabulary.read(text)[: self.config.max_words]
            row = word_vectors().row
            found = [(self.vocabulary.number(word), row(word)) for word in read]
            found = found or [(UNKNOWN, 0)]
            found += [(PADDING, 0)] * (self.config.max_words - len(found))
            if len(self._numbers) < _REMEMBERED:
                self._numbers[text] = found
        return found
