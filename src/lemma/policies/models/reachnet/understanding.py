"""Training sentences of ReachNet's reader, and its readings as plain data."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.batch import NOBODY, Batch
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.interfaces import Understanding
from lemma.policies.models.reachnet.goal_reader import (
    GoalReader,
    Readings,
)
from lemma.policies.models.reachnet.scene_table import CONJUNCTS
from lemma.policies.text.orders import draw_order
from lemma.policies.text.refusals import REASONS, refusal_bank
from lemma.tasks.language.template import GoalPairs

WHY = tuple(REASONS.values())
"""Explanations of refusals by the index of the reason."""


def lesson(reader: GoalReader, batch: Batch, device: torch.device) -> dict[str, Tensor]:
    """Return training sentences with their goals and reasons for refusal.

    After the instructions of the batch come sentences for the reader alone: those to
    refuse, orders that look similar, and orders with other goals.

    Args:
        reader: Its options determine whether it refuses, and the number of these
            sentences.
        batch: Batch with labels.
        device: Device of the result.

    Returns:
        ``words`` of B + M sentences, ``goal``, (B + M, conjuncts, 2), and ``reasons``,
        (B + M,), -1 for orders.
    """
    assert batch.labels is not None
    reasons = [-1] * len(batch)
    said = [*zip(batch.instructions, batch.labels.goals, reasons, strict=True)]
    if reader.config.refuses and not reader.config.guesses:
        # Seeded by the instructions, which are a function of the step.
        rng, bank = stream("refusals", *batch.instructions), refusal_bank()
        count = math.ceil(reader.config.lessons * len(batch))
        said += [bank.draw(rng) for _ in range(count)]
        count = math.ceil(reader.config.orders * len(batch))
        said += [(*draw_order(rng), -1) for _ in range(count)]
    texts, goals, reasons = map(list, zip(*said, strict=True))
    return {
        "goal": goal_numbers(goals, device, batch.entities),
        "words": torch.stack(reader.sentences.read(texts, device)),
        "reasons": torch.tensor(reasons, device=device),
    }


def understood(
    read: Readings, names: Sequence[str], *, refuses: bool
) -> list[Understanding]:
    """Return readings as plain data.

    Args:
        read: Readings of B sentences.
        names: Names of the entities, in the order of their numbers.
        refuses: Whether the reader can refuse.
    """
    found = []
    for goals, shares, reason, refused in zip(*(p.tolist() for p in read), strict=True):
        one, other = (pairs_of(goal, names) for goal in goals)
        if reason >= 0:
            found.append(Understanding((), refused, WHY[reason]))
        else:
            sure, less = shares
            found.append(Understanding(one, sure, "", refuses, other, less))
    return found


def goal_numbers(
    goals: Sequence[GoalPairs],
    device: torch.device,
    entities: EntitySet = BENCHMARK,
) -> Tensor:
    """Return goals as numbers of entities, (B, conjuncts, 2); -1 for none."""
    none = (NOBODY, NOBODY)
    numbers = [
        [
            *((entities.number(a), entities.number(b)) for a, b in pairs[:CONJUNCTS]),
            *(none,) * (CONJUNCTS - len(pairs)),
        ]
        for pairs in goals
    ]
    return torch.tensor(numbers, device=device)


def pairs_of(rows: Sequence[Sequence[int]], names: Sequence[str]) -> GoalPairs:
    """Return a goal by names.

    Args:
        rows: Numbers of (top, bottom) pairs; -1 for none.
        names: Names of the entities.
    """
    return tuple((names[a], names[b]) for a, b in rows if a != NOBODY)
