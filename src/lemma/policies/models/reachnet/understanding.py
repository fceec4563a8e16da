"""The sentences that ReachNet's reader learns from, and its readings in words."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.batch import Batch
from lemma.policies.interfaces import Understanding
from lemma.policies.models.reachnet.goal_reader import (
    GoalReader,
    Readings,
    goal_numbers,
    pairs_of,
)
from lemma.policies.text.refusals import REASONS, refusal_bank

WHY = tuple(REASONS.values())
"""Why a sentence is refused, in words, by the number of the reason."""


def lesson(reader: GoalReader, batch: Batch, device: torch.device) -> dict[str, Tensor]:
    """Return sentences, their goals and reasons to refuse them, as numbers.

    Behind the instructions come sentences for the reader alone: those to refuse, with
    the number of the reason, and orders that look like them.

    Args:
        reader: Its options say whether it refuses, and how many such sentences come.
        batch: With labels.
        device: Where the result lies.

    Returns:
        ``words`` of B + M sentences, ``goal``, (B + M, conjuncts, 2), and ``reasons``,
        (B + M,), -1 for none.
    """
    assert batch.labels is not None
    reasons = [-1] * len(batch)
    said = [*zip(batch.instructions, batch.labels.goals, reasons, strict=True)]
    if reader.config.refuses and not reader.config.guesses:
        # Drawn from what is said, which is a function of the step.
        rng, bank = stream("refusals", *batch.instructions), refusal_bank()
        count = math.ceil(reader.config.lessons * len(batch))
        said += [bank.draw(rng) for _ in range(count)]
    texts, goals, reasons = map(list, zip(*said, strict=True))
    return {
        "goal": goal_numbers(goals, device, batch.entities),
        "words": torch.stack(reader.sentences.read(texts, device)),
        "reasons": torch.tensor(reasons, device=device),
    }


def understood(
    read: Readings, names: Sequence[str], *, refuses: bool
) -> list[Understanding]:
    """Return readings in words.

    Args:
        read: Of B sentences.
        names: Of the entities, by their numbers.
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
