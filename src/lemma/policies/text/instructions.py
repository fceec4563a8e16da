"""New sentences for labelled batches of training and validation."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lemma.core.seeding import stream
from lemma.dataset.instructions import draw_instruction
from lemma.policies.batch import Batch
from lemma.policies.text.paraphrase import paraphrase
from lemma.policies.text.places import relational_in
from lemma.policies.text.rules import say_rule_anew
from lemma.tasks.language.bank import robot_phrases_in_order, say_rule
from lemma.tasks.teams.rule import rule_from


def with_instructions(
    batch: Batch,
    seed: int,
    draw: int,
    kinds: Sequence[str] = ("high_level", "human"),
    paraphrases: float = 0.0,
) -> Batch:
    """Return a batch with instructions drawn from the training templates.

    All frames of an episode get the same instruction.

    Args:
        batch: Batch with labels, which have the goals.
        seed: Seed of all draws.
        draw: Number of the draw; a new number gives new sentences.
        kinds: Kinds to draw from, with equal probability.
        paraphrases: Share of episodes with a sentence from the grammar, or recombined
            from parts of the templates.
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
            if rule := labels.rules[row]:
                rng = stream("rule", seed, draw, episode)
                kind = kinds[int(rng.integers(len(kinds)))]
                robots = robot_phrases_in_order(labels.robot_colors[row])
                said = rule_from(rule)
                if paraphrases and rng.random() < paraphrases:
                    text = say_rule_anew(said, labels.goals[row], text, robots, rng)
                else:
                    text = say_rule(said, kind, text, robots, rng)
            drawn[episode] = text
        texts.append(text)
    return replace(batch, instructions=texts)


def with_places(batch: Batch, share: float, rng: np.random.Generator) -> Batch:
    """Return a batch in which some sentences name things by their places.

    They are about the frame's own scene, as if the episode began there.

    Args:
        batch: Batch with labels.
        share: Share of the frames.
        rng: Random generator.
    """
    rows = np.flatnonzero(rng.random(len(batch)) < share).tolist()
    texts = list(batch.instructions)
    for row, text in zip(rows, relational_in(batch, rows, rng), strict=True):
        texts[row] = text
    return replace(batch, instructions=texts)


def with_language(batch: Batch, language: str, rng: np.random.Generator) -> Batch:
    """Return a batch with the instructions of a control experiment.

    Args:
        batch: Batch with labels.
        language: ``"full"``: unchanged; ``"none"``: empty; ``"shuffled"``: those of
            other episodes.
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
    other_rows = [rows[others[episode]] for episode in episodes]
    chosen = [of[int(rng.integers(len(of)))] for of in other_rows]
    return replace(
        batch,
        instructions=[batch.instructions[of[0]] for of in other_rows],
        sub_instructions=[batch.sub_instructions[row] for row in chosen],
    )


def _deranged(episodes: Sequence[int], rng: np.random.Generator) -> list[int]:
    """Return another episode for each episode, if there is more than one."""
    names = list(dict.fromkeys(episodes))
    order = rng.permutation(len(names)).tolist()
    after = dict(zip(order, [*order[1:], order[0]], strict=True))
    return [names[after[i]] for i in range(len(names))]
