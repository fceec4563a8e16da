"""Sentences of training episodes: drawn anew, or controls."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lemma.core.seeding import stream
from lemma.dataset.instructions import draw_instruction
from lemma.policies.batch import Batch
from lemma.policies.text.paraphrase import paraphrase


def with_instructions(
    batch: Batch,
    seed: int,
    draw: int,
    kinds: Sequence[str] = ("high_level", "human"),
    paraphrases: float = 0.0,
) -> Batch:
    """Return a batch whose instructions are drawn from the templates for training.

    All frames of an episode are given the same one.

    Args:
        batch: With labels, whose goals are said.
        seed: Seeds all draws.
        draw: A new one gives new sentences.
        kinds: Kinds to draw from, each as likely.
        paraphrases: Share of episodes whose sentence is made by rules, or put together
            anew from parts of those templates.
    """
    assert batch.labels is not None
    drawn: dict[int, str] = {}
    texts = []
    labels = batch.labels
    for row, episode in enumerate(labels.episode.tolist()):
        text = drawn.get(episode)
        if text is None:
            task, goal = labels.tasks[row], labels.goals[row]
            rng = stream("paraphrase", seed, draw, episode) if paraphrases else None
            if rng is not None and rng.random() < paraphrases:
                text = paraphrase(task, goal, rng)
            else:
                text = draw_instruction(
                    task, goal, str(episode), seed=seed, epoch=draw, kinds=kinds
                )
            drawn[episode] = text
        texts.append(text)
    return replace(batch, instructions=texts)


def with_language(batch: Batch, language: str, rng: np.random.Generator) -> Batch:
    """Return a batch in which as much is said as a control allows.

    Args:
        batch: With labels.
        language: ``"full"``; ``"none"``: nothing is said; or ``"shuffled"``: what is
            said was said to another episode.
        rng: Random generator of the exchange.
    """
    if language == "full":
        return batch
    if language == "none":
        nothing = [""] * len(batch)
        return replace(batch, instructions=nothing, sub_instructions=nothing)
    assert batch.labels is not None
    episodes = batch.labels.episode.tolist()
    others = dict(zip(dict.fromkeys(episodes), _deranged(episodes, rng), strict=True))
    rows: dict[int, list[int]] = {}
    for row, episode in enumerate(episodes):
        rows.setdefault(episode, []).append(row)
    told = [rows[others[episode]] for episode in episodes]
    chosen = [of[int(rng.integers(len(of)))] for of in told]
    return replace(
        batch,
        instructions=[batch.instructions[of[0]] for of in told],
        sub_instructions=[batch.sub_instructions[row] for row in chosen],
    )


def _deranged(episodes: Sequence[int], rng: np.random.Generator) -> list[int]:
    """Return for each episode another one, where there is one."""
    names = list(dict.fromkeys(episodes))
    order = rng.permutation(len(names)).tolist()
    after = dict(zip(order, [*order[1:], order[0]], strict=True))
    return [names[after[i]] for i in range(len(names))]
