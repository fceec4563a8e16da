"""Sentences and goals as numbers, and readings as plain data."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, Batch
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.interfaces import Understanding
from lemma.policies.layers import sent
from lemma.policies.models.reachnet.goal_reader import (
    GoalReader,
    ReaderConfig,
    Readings,
)
from lemma.policies.models.reachnet.scene_table import CONJUNCTS
from lemma.policies.text.encoder import sentences_of
from lemma.policies.text.lessons import Lessons
from lemma.policies.text.refusals import REASONS
from lemma.tasks.language.template import GoalPairs

WHY = tuple(REASONS.values())
"""Explanations of refusals by the index of the reason."""


def lessons_of(
    config: ReaderConfig, entities: EntitySet, frames: int
) -> Lessons | None:
    """Return the draws of sentences for a reader alone; None if it has none.

    Args:
        config: Options of the reader.
        entities: Entities, in the order of their numbers.
        frames: Number of frames in a batch.
    """
    similar, orders = (
        math.ceil(share * frames) for share in (config.lessons, config.orders)
    )
    if not config.refuses or config.guesses or similar + orders == 0:
        return None
    return Lessons(config.max_words, entities, similar, orders)


def reader_tensors(
    reader: GoalReader, batch: Batch, device: torch.device
) -> dict[str, Tensor]:
    """Return the instructions of a batch, and then its lesson, as numbers.

    Args:
        reader: Reader of the sentences.
        batch: Batch with labels, with or without a lesson of M sentences.
        device: Device of the result.

    Returns:
        ``words`` of B + M sentences; ``goal``, (B + M, conjuncts, 2); and ``reasons``
        for refusal, (B + M,), -1 for orders.
    """
    assert batch.labels is not None
    rows = [reader.sentences.rows(batch.instructions)]
    goals, reasons = [*batch.labels.goals], [-1] * len(batch)
    if batch.lesson is not None:
        rows.append(batch.lesson.rows)
        goals += batch.lesson.goals
        reasons += batch.lesson.reasons
    return {
        "words": torch.stack(sentences_of(np.concatenate(rows), device)),
        "goal": goal_numbers(goals, device, batch.entities),
        "reasons": sent(torch.tensor(reasons), device),
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
    return sent(torch.tensor(numbers), device)


def pairs_of(rows: Sequence[Sequence[int]], names: Sequence[str]) -> GoalPairs:
    """Return a goal by names.

    Args:
        rows: Numbers of (top, bottom) pairs; -1 for none.
        names: Names of the entities.
    """
    return tuple((names[a], names[b]) for a, b in rows if a != NOBODY)
