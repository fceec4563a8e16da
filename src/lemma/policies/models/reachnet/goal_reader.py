"""ReachNet's reader: from a sentence to the (top, bottom) pairs of its goal.

The reader finds the mentions: words that name a color, or an entity that exists in one
color only. It scores the kind of each mention, and for every two of them that the first
is to be on the second. The score of a goal is the sum over its pairs, with a softmax
over all possible goals. So the reader cannot memorise colors or positions in sentences.

It also predicts the probability that a sentence is an order, and otherwise the reason
for refusal: p(goal) = p(order) p(goal | order). Goals and reasons for refusal form one
distribution.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Count, Depth, Ratio, Share, Temperature, Width
from lemma.policies.batch import NOBODY
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.layers import TransformerLayer, made_without_numbers
from lemma.policies.models.reachnet.scene_table import CONJUNCTS
from lemma.policies.text.encoder import (
    NO_NAME,
    SentenceReader,
    Sentences,
    Texts,
    WordEmbedding,
    groups_of,
)
from lemma.policies.text.refusals import REASONS

_MENTIONS = 12
"""Largest number of mentions in a sentence."""
_NEVER = -30.0
_ABSENT = -6.0
"""Change of a goal's log-probability for each entity that is not seen."""
_FAR = 24
"""Largest relative position of words; larger ones are clipped."""
_NEAR = 5
"""Width of the convolution over words before the attention."""
_SCALE = 10.0
"""Ratio of the learning rate of position biases to that of other weights."""


@dataclass(frozen=True)
class ReaderConfig:
    """Options of a :class:`GoalReader`."""

    width: Width = 128
    """Width of a token."""
    layers: Depth = 3
    """Transformer layers over the words."""
    heads: Depth = 4
    """Number of heads of the attention."""
    max_words: Count = 80
    """Largest number of words and punctuation marks; later ones are not read."""
    dropout: Share = 0.1
    """Probability of dropout in training."""
    word_dropout: Share = 0.08
    """Share of words that are replaced by the unknown word in training."""
    embedding_dropout: Share = 0.4
    """Share of words without their learned embedding in training, so that the reader
    learns to use the pretrained vectors."""
    guesses: bool = False
    """Whether a text without words has the goal that is most likely in the scene,
    instead of none: for a reader that is trained without sentences."""
    refuses: bool = True
    """Whether the reader predicts that a sentence is no order, and why."""
    lessons: Share = 0.5
    """Number of sentences for the reader alone, per frame of a training batch:
    sentences to refuse, and orders that look similar. Only for a reader that
    refuses."""
    orders: Ratio = 2.0
    """Number of paraphrased orders for the reader alone, per frame, with goals of any
    task. Only for a reader that refuses."""
    refuse_from: Share = 0.7
    """Probability of refusal from which the policy stops."""
    temperature: Temperature = 1.8
    """Divisor of the log-probabilities of goals and of reasons, for calibrated
    probabilities."""


class Readings(NamedTuple):
    """Readings of B sentences."""

    goals: Tensor
    """The two most likely goals, (B, 2, conjuncts, 2); -1 for none."""
    shares: Tensor
    """Probabilities of these goals, (B, 2)."""
    reasons: Tensor
    """Index of the most likely reason for refusal, (B,); -1 for an order."""
    refused: Tensor
    """Probability of refusal, (B,)."""


class Mentions(NamedTuple):
    """At most M mentions of entities in each of B sentences.

    ``tokens`` (B, L, width) are those of all words, ``said`` (B, M, width) those of the
    mentions, ``whole`` (B, width) those of sentences. ``group`` (B, M) is the group of
    entities that a mention may name, or -1; ``at`` (B, M) is its place in the sentence.
    """

    said: Tensor
    group: Tensor
    at: Tensor
    tokens: Tensor
    whole: Tensor


class GoalReader(WordEmbedding):
    """A network from sentences to goals."""

    goals: Tensor
    numbers: Tensor
    group: Tensor
    kinds: Tensor

    def __init__(
        self, config: ReaderConfig | None = None, entities: EntitySet = BENCHMARK
    ) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
            entities: Entities, in the order of their numbers; goals may have all except
                the stick.
        """
        config = config or ReaderConfig()
        width = config.width
        super().__init__(
            SentenceReader(config.max_words, entities), width, meaning=True
        )
        self.config = config
        self.cargo, self.targets = entities.cargo, entities.stick
        self.near = nn.Conv1d(width, width, _NEAR, padding="same")
        self.apart = nn.Parameter(_slopes(config.heads))
        self.alike = nn.Parameter(torch.full((config.heads,), 1.0 / _SCALE))
        self.layers = nn.ModuleList(
            TransformerLayer(width, config.heads, 2 * width, config.dropout)
            for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(width)
        self.top, self.bottom = (nn.Linear(width, width) for _ in range(2))
        names = [kind.name for kind in entities.kinds[: self.targets]]
        distinct = list(dict.fromkeys(names))
        self.kind = nn.Linear(width, len(distinct))
        self.count = nn.Linear(width, CONJUNCTS)
        self.order: nn.Sequential | None = None
        if config.refuses:
            last = nn.Linear(width, 1 + len(REASONS))
            # The initial bias makes nearly all sentences orders.
            nn.init.constant_(last.bias[:1], 4.0)
            self.order = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), last)
        goals, numbers = _goals(self.cargo, self.targets)
        group = torch.tensor(groups_of(entities)[0])
        kinds = torch.tensor([distinct.index(name) for name in names])
        self.register_buffer("goals", goals, persistent=False)
        self.register_buffer("numbers", numbers, persistent=False)
        self.register_buffer("group", group, persistent=False)
        self.register_buffer("kinds", kinds, persistent=False)

    def forward(self, texts: Texts) -> Tensor:
        """Return the log-probability of every goal and reason, (B, goals + reasons)."""
        sentences = self.sentences.read(texts, self.alike.device)
        scores, order, _ = self._scores(sentences)
        return _joint(scores, order)

    def loss(
        self, texts: Texts, goals: Tensor, reasons: Tensor | None = None
    ) -> Tensor:
        """Return the mean negative log-likelihood of goals and reasons.

        Args:
            texts: Sentences.
            goals: Their goals, (B, conjuncts, 2), in any order; -1 for none.
            reasons: Indices of the reasons for refusal, (B,); -1 for orders. None if
                all are orders.
        """
        wanted = self._number(goals)
        if reasons is not None:
            wanted = torch.where(reasons < 0, wanted, len(self.goals) + reasons)
        return F.nll_loss(self(texts), wanted)

    @torch.no_grad()
    def read(
        self, texts: Sequence[str], present: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the most likely goals, (B, conjuncts, 2), and reasons, (B,).

        -1 stands for no goal, and for no reason for refusal.

        The pairs are in the order of their mentions. A refused sentence has no goal,
        and neither has a text without words, unless the option ``guesses`` is set.

        Args:
            texts: Sentences.
            present: Whether entities are seen, (B, entities) bool. Goals with unseen
                entities are less likely: "the red one" means an object in the scene.
        """
        found = self.weigh(texts, present)
        acts = found.refused < self.config.refuse_from
        goals = found.goals[:, 0].masked_fill(~acts[:, None, None], NOBODY)
        return goals, found.reasons.masked_fill(acts, -1)

    @torch.no_grad()
    def weigh(self, texts: Sequence[str], present: Tensor | None = None) -> Readings:
        """Return the most likely goals with their probabilities; see :meth:`read`.

        The probability of refusal does not depend on the scene, so it is constant
        throughout an episode.
        """
        sentences = self.sentences.read(texts, self.alike.device)
        scores, order, first = self._scores(sentences)
        if present is not None:
            missing = F.pad(~present[:, : self.targets], (0, 1)).float() * _ABSENT
            scores = scores + missing[:, self.goals].sum((2, 3))
        scores = scores / self.config.temperature
        if order is not None:
            order = (order / self.config.temperature).log_softmax(-1)
        shares = _joint(scores, order).exp()
        count = len(self.goals)
        likely, number = shares[:, :count].topk(2)
        best = self.goals[number]
        # A missing pair comes last.
        places = F.pad(first, (0, 1), value=2 * self.config.max_words)
        named = (best % (self.targets + 1)).flatten(1)
        place = places.gather(1, named).view_as(best).amin(-1)
        at = place.argsort(dim=2, stable=True)
        best = best.gather(2, at[..., None].expand_as(best))
        silent = ~sentences.mask.any(1) & (not self.config.guesses)
        best = best.masked_fill(silent[:, None, None, None], NOBODY)
        likely = likely.masked_fill(silent[:, None], 1.0)
        refused = shares[:, count:].sum(-1).masked_fill(silent, 0.0)
        reasons = torch.full_like(number[:, 0], -1)
        if order is not None:
            reasons = torch.where(refused > 0.5, order[:, 1:].argmax(-1), reasons)
        return Readings(best, likely, reasons, refused)

    def _scores(self, sentences: Sentences) -> tuple[Tensor, Tensor | None, Tensor]:
        """Return scores and mentions of sentences.

        Returns:
            The score of each goal, (B, goals); the log-probability of an order and of
            each reason for refusal, (B, 1 + reasons), or None; and the position of each
            entity's first mention, (B, T).
        """
        found = self.mentions(sentences)
        order = None
        if self.order is not None:
            words = sentences.mask.unsqueeze(2)
            most = found.tokens.masked_fill(~words, _NEVER).amax(1)
            both = torch.cat([found.whole, most], -1)
            order = self.order(both).float().log_softmax(-1)
        meant = found.group[:, :, None] == self.group
        pairs = self.pairs(found.said, meant)
        count = self.count(found.whole).float().log_softmax(-1)
        # An extra pair of score 0 is the second pair of goals with a single pair.
        flat = F.pad(pairs.flatten(1), (0, 1))
        one = self.goals[..., 0] == NOBODY
        slots = self.goals[..., 0] * self.targets + self.goals[..., 1]
        slots = torch.where(one, flat.shape[1] - 1, slots)
        size = (~one).sum(-1) - 1
        length = found.tokens.shape[1]
        first = torch.where(meant, found.at[:, :, None], length).amin(1)
        return flat[:, slots].sum(-1) + count[:, size], order, first

    def mentions(self, sentences: Sentences, most: int = _MENTIONS) -> Mentions:
        """Return the mentions of entities in sentences, at most ``most`` each."""
        tokens, whole = self._encoded(sentences)
        length = tokens.shape[1]
        place = torch.arange(length, device=tokens.device)
        at = torch.where(sentences.names != NO_NAME, place, length)
        at = at.sort(1).values[:, :most]
        index = at.clamp(max=length - 1)
        said = tokens.gather(1, index[:, :, None].expand(-1, -1, tokens.shape[2]))
        group = torch.where(at < length, sentences.names.gather(1, index), NO_NAME)
        return Mentions(said, group, at, tokens, whole)

    def pairs(self, said: Tensor, meant: Tensor) -> Tensor:
        """Return the score of each (top, bottom) pair, (B, C, T).

        Args:
            said: Tokens of the mentions, (B, M, width).
            meant: Whether each mention may name each entity, (B, M, T) bool.
        """
        top, bottom = self.top(said).float(), self.bottom(said).float()
        fit = top @ bottom.transpose(1, 2) / top.shape[-1] ** 0.5
        # One mention cannot be both, but two mentions may have the same color.
        same = torch.eye(said.shape[1], dtype=torch.bool, device=said.device)
        fit = fit.masked_fill(same, _NEVER)
        kind = self.kind(said).float().log_softmax(-1)[:, :, self.kinds]
        kind = torch.where(meant, kind, _NEVER)
        tops = kind[:, :, None, : self.cargo, None]
        both = fit[..., None, None] + tops + kind[:, None, :, None]
        found: Tensor = both.flatten(1, 2).logsumexp(1).clamp(min=2 * _NEVER)
        return found

    def _encoded(self, sentences: Sentences) -> tuple[Tensor, Tensor]:
        """Return tokens of words, (B, L, width), and of whole sentences, (B, width)."""
        mask = sentences.mask
        spared = (sentences.names != NO_NAME) | ~mask
        dropped = self.drawn(spared, self.config.word_dropout)
        bare = self.drawn(spared, self.config.embedding_dropout) & (sentences.rows > 0)
        tokens = self.embedded(sentences, dropped, bare)
        tokens = tokens.masked_fill(~mask.unsqueeze(2), 0.0)
        tokens = tokens + F.gelu(self.near(tokens.transpose(1, 2)).transpose(1, 2))
        bias = self._bias(sentences, mask)
        for layer in self.layers:
            tokens = layer(tokens, bias)
        tokens = self.norm(tokens)
        weights = mask.unsqueeze(2).to(tokens.dtype)
        whole = (tokens * weights).sum(1) / weights.sum(1).clamp(min=1)
        return tokens, whole

    def _bias(self, sentences: Sentences, mask: Tensor) -> Tensor:
        """Return the attention bias, (B, heads, L, L)."""
        place = torch.arange(mask.shape[1], device=mask.device)
        away = (place[None] - place[:, None]).clamp(-_FAR, _FAR) + _FAR
        same = (sentences.names[:, :, None] == sentences.names[:, None]) & (
            sentences.names != NO_NAME
        )[:, :, None]
        bias = _SCALE * (self.apart[away][None] + same[..., None] * self.alike)
        seen = mask[:, None, :, None] | (place[None, :, None, None] == place[:, None])
        return bias.masked_fill(~seen, _NEVER).permute(0, 3, 1, 2)

    def _number(self, goals: Tensor) -> Tensor:
        """Return the indices of goals, (B,)."""
        top, bottom = goals.unbind(-1)
        none = self.cargo * self.targets
        slots = torch.where(top == NOBODY, none, top * self.targets + bottom)
        found: Tensor = self.numbers[tuple(slots.sort(1).values.unbind(1))]
        return found


def _joint(scores: Tensor, order: Tensor | None) -> Tensor:
    """Return the log-probabilities of goals and of reasons, (B, goals + reasons)."""
    goals = scores.log_softmax(-1)
    if order is None:
        return goals
    return torch.cat([goals + order[:, :1], order[:, 1:]], -1)


def _slopes(heads: int) -> Tensor:
    """Return initial biases of relative positions, (2 * far + 1, heads).

    Nearer words have larger biases. Half of the heads prefer the words before, the
    others those after.
    """
    if made_without_numbers():
        return torch.empty(2 * _FAR + 1, heads)
    away = torch.arange(-_FAR, _FAR + 1.0)[:, None]
    slope = 2.0 ** -torch.arange(1, heads + 1.0)
    side = torch.tensor([1.0, -1.0]).repeat(heads)[:heads]
    return (-slope * away.abs() - (away * side < 0) * 2.0) / _SCALE


def _goals(cargo: int, targets: int) -> tuple[Tensor, Tensor]:
    """Return all goals, (goals, 2, 2), and their indices by the numbers of their pairs.

    A top is movable, is in one pair only, and is not on an object that is on itself.
    """
    single = [(t, b) for t in range(cargo) for b in range(targets) if t != b]
    nothing = (NOBODY, NOBODY)
    found = [(pair, nothing) for pair in single]
    found += [
        (one, two)
        for one, two in combinations(single, 2)
        if one[0] != two[0] and one != two[::-1]
    ]
    none = cargo * targets
    numbers = torch.zeros(none + 1, none + 1, dtype=torch.int64)
    for number, pairs in enumerate(found):
        slots = [none if t == NOBODY else t * targets + b for t, b in pairs]
        numbers[tuple(sorted(slots))] = number
    return torch.tensor(found), numbers
