"""ReachNet's reader: from a sentence to the (top, bottom) pairs that it asks for."""

import re
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import NOBODY
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.models.reachnet.scene_table import CONJUNCTS
from lemma.policies.text.encoder import TextConfig, TextEncoder
from lemma.tasks.language.template import GoalPairs


class GoalReader(nn.Module):
    """Reads a goal: one query per role looks for its entity among the words."""

    def __init__(self, text: TextConfig, entities: EntitySet = BENCHMARK) -> None:
        """Make the weights.

        Args:
            text: Of the encoder.
            entities: What has a number; goals may name all but the stick.
        """
        super().__init__()
        self.cargo, self.targets = entities.cargo, entities.stick
        self.text = TextEncoder(text)
        width = text.width
        self.roles = nn.Parameter(0.5 * torch.randn(2 * CONJUNCTS, width))
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        self.out = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, width), nn.GELU()
        )
        self.entity = nn.Linear(width, self.targets + 1)

    def forward(self, texts: Sequence[str]) -> Tensor:
        """Return log-probabilities of each role's entity, or of none behind them.

        Returns:
            (B, conjuncts, 2, targets + 1): top and bottom of each conjunct.
        """
        tokens, mask = self.text.encode(texts)
        keys, values = self.key(tokens), self.value(tokens)
        looks = torch.einsum("rd,bld->brl", self.roles, keys) / keys.shape[-1] ** 0.5
        looks = looks.masked_fill(~mask.unsqueeze(1), -torch.inf).softmax(-1)
        found = self.out(looks @ values + self.roles)
        logits: Tensor = self.entity(found).float()
        return logits.log_softmax(-1).view(len(tokens), CONJUNCTS, 2, self.targets + 1)

    def loss(self, texts: Sequence[str], goals: Tensor) -> Tensor:
        """Return how badly goals are read; a mean over roles.

        Args:
            texts: Sentences.
            goals: What they ask for, (B, conjuncts, 2); -1 for none.
        """
        logs = self(texts).flatten(0, 2)
        target = torch.where(goals == NOBODY, self.targets, goals).flatten()
        return F.nll_loss(logs, target)

    @torch.no_grad()
    def read(self, texts: Sequence[str]) -> Tensor:
        """Return the likeliest goals, (B, conjuncts, 2); -1 for none.

        A top can be moved, and nothing lies on itself.
        """
        logs = self(texts)
        joint = logs[:, :, 0, :, None] + logs[:, :, 1, None, :]
        joint[..., self.cargo : self.targets, :] = -torch.inf
        joint[..., : self.targets, self.targets] = joint[
            ..., self.targets, : self.targets
        ] = -torch.inf
        same = torch.eye(self.targets + 1, dtype=torch.bool, device=logs.device)
        same[self.targets, self.targets] = False
        joint = joint.masked_fill(same, -torch.inf)
        # Without a first pair there is no second one.
        joint[:, 0, self.targets, self.targets] = -torch.inf
        best = joint.flatten(2).argmax(-1)
        width = self.targets + 1
        pair = torch.stack([best // width, best % width], -1)
        return torch.where(pair == self.targets, NOBODY, pair)


def goal_numbers(
    goals: Sequence[GoalPairs],
    device: torch.device,
    entities: EntitySet = BENCHMARK,
) -> Tensor:
    """Return goals as numbers of entities, (B, conjuncts, 2); -1 for none."""
    numbers = torch.full((len(goals), CONJUNCTS, 2), NOBODY)
    for row, pairs in enumerate(goals):
        for place, pair in enumerate(pairs[:CONJUNCTS]):
            for side, name in enumerate(pair):
                numbers[row, place, side] = entities.number(name)
    return numbers.to(device)


def _renamed(new: dict[str, str], found: re.Match[str]) -> str:
    return new[found[0].lower()]


def recolored(
    texts: Sequence[str], goals: Tensor, entities: EntitySet = BENCHMARK
) -> tuple[list[str], Tensor]:
    """Return sentences and goals with the colors exchanged, each in its own way.

    Args:
        texts: Sentences.
        goals: (B, conjuncts, 2); -1 for none.
        entities: What has a number.
    """
    names, alike = entities.colors, entities.colored_as
    color = re.compile(r"\b(" + "|".join(names) + r")\b", re.IGNORECASE)
    written, tables = [], []
    for text in texts:
        order = torch.randperm(len(names)).tolist()
        new = {name: names[order[i]] for i, name in enumerate(names)}
        written.append(color.sub(partial(_renamed, new), text))
        numbers = zip(alike, entities.color_numbers, strict=True)
        tables.append([*(row[order[old]] for row, old in numbers), NOBODY])
    lookup = torch.tensor(tables).to(goals.device)
    moved = lookup.gather(1, goals.flatten(1) % lookup.shape[1])
    return written, moved.view_as(goals)
