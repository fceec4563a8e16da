"""ReachNet's reader: from a sentence to the (top, bottom) pairs that it asks for."""

import re
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import NOBODY
from lemma.policies.models.reachnet.scene_table import CONJUNCTS, CUBES
from lemma.policies.text.encoder import TextConfig, TextEncoder
from lemma.scene.objects.entity import ENTITIES
from lemma.scene.palette import BENCHMARK_COLORS
from lemma.tasks.language.template import GoalPairs

_COLOR = re.compile(r"\b(" + "|".join(BENCHMARK_COLORS) + r")\b", re.IGNORECASE)
_TARGETS = len(CUBES) * 2
"""Cubes and pads: what a goal may name."""


class GoalReader(nn.Module):
    """Reads a goal: one query per role looks for its entity among the words."""

    def __init__(self, text: TextConfig) -> None:
        """Make the weights.

        Args:
            text: Of the encoder.
        """
        super().__init__()
        self.text = TextEncoder(text)
        width = text.width
        self.roles = nn.Parameter(0.5 * torch.randn(2 * CONJUNCTS, width))
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        self.out = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, width), nn.GELU()
        )
        self.entity = nn.Linear(width, _TARGETS + 1)

    def forward(self, texts: Sequence[str]) -> Tensor:
        """Return log-probabilities of each role's entity, or of none behind them.

        Returns:
            (B, conjuncts, 2, 11): top and bottom of each conjunct.
        """
        tokens, mask = self.text.encode(texts)
        keys, values = self.key(tokens), self.value(tokens)
        looks = torch.einsum("rd,bld->brl", self.roles, keys) / keys.shape[-1] ** 0.5
        looks = looks.masked_fill(~mask.unsqueeze(1), -torch.inf).softmax(-1)
        found = self.out(looks @ values + self.roles)
        logits: Tensor = self.entity(found).float()
        return logits.log_softmax(-1).view(len(tokens), CONJUNCTS, 2, _TARGETS + 1)

    def loss(self, texts: Sequence[str], goals: Tensor) -> Tensor:
        """Return how badly goals are read; a mean over roles.

        Args:
            texts: Sentences.
            goals: What they ask for, (B, conjuncts, 2); -1 for none.
        """
        logs = self(texts).flatten(0, 2)
        target = torch.where(goals == NOBODY, _TARGETS, goals).flatten()
        return F.nll_loss(logs, target)

    @torch.no_grad()
    def read(self, texts: Sequence[str]) -> Tensor:
        """Return the likeliest goals, (B, conjuncts, 2); -1 for none.

        A top is a cube, and nothing lies on itself.
        """
        logs = self(texts)
        joint = logs[:, :, 0, :, None] + logs[:, :, 1, None, :]
        joint[..., len(CUBES) : _TARGETS, :] = -torch.inf
        joint[..., :_TARGETS, _TARGETS] = joint[..., _TARGETS, :_TARGETS] = -torch.inf
        same = torch.eye(_TARGETS + 1, dtype=torch.bool, device=logs.device)
        same[_TARGETS, _TARGETS] = False
        joint = joint.masked_fill(same, -torch.inf)
        # Without a first pair there is no second one.
        joint[:, 0, _TARGETS, _TARGETS] = -torch.inf
        best = joint.flatten(2).argmax(-1)
        width = _TARGETS + 1
        pair = torch.stack([best // width, best % width], -1)
        return torch.where(pair == _TARGETS, NOBODY, pair)


def goal_numbers(goals: Sequence[GoalPairs], device: torch.device) -> Tensor:
    """Return goals as numbers of entities, (B, conjuncts, 2); -1 for none."""
    numbers = torch.full((len(goals), CONJUNCTS, 2), NOBODY)
    for row, pairs in enumerate(goals):
        for place, pair in enumerate(pairs[:CONJUNCTS]):
            for side, name in enumerate(pair):
                numbers[row, place, side] = ENTITIES.index(name)
    return numbers.to(device)


def _renamed(new: dict[str, str], found: re.Match[str]) -> str:
    return new[found[0].lower()]


def recolored(texts: Sequence[str], goals: Tensor) -> tuple[list[str], Tensor]:
    """Return sentences and goals with the colors exchanged, each in its own way.

    Args:
        texts: Sentences.
        goals: (B, conjuncts, 2); -1 for none.
    """
    names = list(BENCHMARK_COLORS)
    count = len(names)
    written, tables = [], []
    for text in texts:
        order = torch.randperm(count).tolist()
        new = {name: names[order[i]] for i, name in enumerate(names)}
        written.append(_COLOR.sub(partial(_renamed, new), text))
        tables.append([*order, *(count + i for i in order), NOBODY])
    lookup = torch.tensor(tables).to(goals.device)
    moved = lookup.gather(1, goals.flatten(1) % (2 * count + 1))
    return written, moved.view_as(goals)
