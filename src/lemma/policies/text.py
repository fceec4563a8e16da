"""Text as tokens for the networks: plain English in, vectors out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from lemma.core.errors import UnknownNameError
from lemma.policies.transformer import TransformerLayer, sinusoids
from lemma.policies.vocabulary import PADDING, UNKNOWN, Vocabulary

TEXT_KINDS = ("words",)
"""Kinds of encoders."""


@dataclass(frozen=True)
class TextConfig:
    """Options of a :class:`TextEncoder`."""

    kind: Literal["words"] = "words"
    """``words``: learned embeddings of the words that training sees."""
    width: int = 256
    """Of a token."""
    layers: int = 2
    """Transformer layers over the words."""
    heads: int = 4
    """Of the attention."""
    max_words: int = 40
    """Words behind these are not read."""
    dropout: float = 0.1
    """Share of values that are left out in training."""
    word_dropout: float = 0.1
    """Share of words that are unknown in training; colours of objects always are
    known, because nothing else could tell them."""


class TextEncoder(nn.Module):
    """Turns sentences into tokens, on the device of its weights."""

    def __init__(self, config: TextConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        super().__init__()
        self.config = config = config or TextConfig()
        if config.kind not in TEXT_KINDS:
            raise UnknownNameError("kind of text encoder", config.kind, TEXT_KINDS)
        self.vocabulary = Vocabulary()
        self.embedding = nn.Embedding(
            len(self.vocabulary), config.width, padding_idx=PADDING
        )
        nn.init.normal_(self.embedding.weight, std=0.5)
        self.places: Tensor
        self.register_buffer(
            "places", sinusoids(config.max_words, config.width), persistent=False
        )
        self.known: Tensor
        always = torch.zeros(len(self.vocabulary), dtype=torch.bool)
        always[[PADDING, *self.vocabulary.colours]] = True
        self.register_buffer("known", always, persistent=False)
        self.layers = nn.ModuleList(
            TransformerLayer(
                config.width, config.heads, 2 * config.width, config.dropout
            )
            for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(config.width)
        self._numbers: dict[str, tuple[int, ...]] = {}

    def encode(self, texts: Sequence[str]) -> tuple[Tensor, Tensor]:
        """Return tokens (B, L, width), and which of them are words, (B, L) bool.

        There is at least one: a text without words is one unknown word.

        Args:
            texts: One per row; upper case, punctuation and typing errors are fine.
        """
        rows = [self._read(text) for text in texts]
        numbers = torch.tensor(rows).to(self.embedding.weight.device)
        mask = numbers != PADDING
        if self.training and self.config.word_dropout:
            chances = torch.rand(numbers.shape, device=numbers.device)
            drop = (chances < self.config.word_dropout) & ~self.known[numbers]
            numbers = torch.where(drop, UNKNOWN, numbers)
        tokens = self.embedding(numbers) + self.places
        for layer in self.layers:
            tokens = layer(tokens, mask.unsqueeze(1))
        return self.norm(tokens), mask

    def pooled(self, texts: Sequence[str]) -> Tensor:
        """Return one vector per text, (B, width): the mean of its tokens."""
        tokens, mask = self.encode(texts)
        weights = mask.unsqueeze(2).to(tokens.dtype)
        return (tokens * weights).sum(1) / weights.sum(1)

    def forward(self, texts: Sequence[str]) -> tuple[Tensor, Tensor]:
        """Encode; see :meth:`encode`."""
        return self.encode(texts)

    def _read(self, text: str) -> tuple[int, ...]:
        found = self._numbers.get(text)
        if found is None:
            read = self.vocabulary.read(text)[: self.config.max_words]
            row = [self.vocabulary.number(word) for word in read] or [UNKNOWN]
            found = (*row, *[PADDING] * (self.config.max_words - len(row)))
            if len(self._numbers) < _REMEMBERED:
                self._numbers[text] = found
        return found


_REMEMBERED = 100_000
"""Texts whose numbers are kept."""
