"""Text as tokens for the networks: plain English in, vectors out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from lemma.core.arguments import Count, Depth, Share, Width
from lemma.policies.layers import TransformerLayer, sinusoids
from lemma.policies.text.sentences import SentenceReader, Sentences
from lemma.policies.text.vocabulary import PADDING, UNKNOWN
from lemma.policies.text.word_vectors import word_vectors

TextKind = Literal["words", "words+vectors"]
"""Kinds of encoders."""


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
    """Words behind these are not read."""
    dropout: Share = 0.1
    """Share of values that are left out in training."""
    word_dropout: Share = 0.1
    """Share of words that are unknown in training; colors of objects always are
    known, because nothing else could tell them."""
    embedding_dropout: Share = 0.5
    """Share of words whose learned embedding is left out in training, so that their
    vectors must do; of ``words+vectors`` only, and never of colors."""


class WordEmbedding(nn.Module):
    """One token per word: what training learns of it, and what English means by it."""

    vectors: Tensor

    def __init__(self, sentences: SentenceReader, width: int, *, meaning: bool) -> None:
        """Make the weights.

        Args:
            sentences: Gives words their numbers.
            width: Width of a token.
            meaning: Whether pretrained vectors are added.
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

    def embedded(self, told: Sentences, dropped: Tensor, bare: Tensor) -> Tensor:
        """Return a token for each word, (B, L, width).

        Args:
            told: The words.
            dropped: Words that are unknown, (B, L) bool.
            bare: Words shown only by their pretrained vector, (B, L) bool.
        """
        learned: Tensor = self.embedding(
            told.numbers.masked_fill(dropped | bare, UNKNOWN)
        )
        if self.meaning is None:
            return learned
        vectors: Tensor = self.meaning(self.vectors[told.rows])
        return vectors.masked_fill(dropped.unsqueeze(2), 0.0) + learned

    def drawn(self, spared: Tensor, share: float) -> Tensor:
        """Return which words are left out: none but in training.

        Args:
            spared: Words that never are, (B, L) bool.
            share: Share of the others.
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

    def encode(self, texts: Sequence[str]) -> tuple[Tensor, Tensor]:
        """Return tokens (B, L, width), and which of them are words, (B, L) bool.

        There is at least one: a text without words is one unknown word.

        Args:
            texts: One per row; upper case, punctuation and typing errors are fine.
        """
        told = self.sentences.read(texts, self.places.device)
        mask, spared = told.mask, self.known[told.numbers]
        dropped = bare = self.drawn(spared, self.config.word_dropout)
        if self.meaning is not None:
            bare = self.drawn(spared, self.config.embedding_dropout)
        tokens = self.embedded(told, dropped, bare) + self.places[: mask.shape[1]]
        for layer in self.layers:
            tokens = layer(tokens, mask.unsqueeze(1))
        return self.norm(tokens), mask

    def pooled(self, texts: Sequence[str]) -> Tensor:
        """Return one vector per text, (B, width): the mean of its tokens."""
        tokens, mask = self.encode(texts)
        weights = mask.unsqueeze(2).to(tokens.dtype)
        return (tokens * weights).sum(1) / weights.sum(1)
