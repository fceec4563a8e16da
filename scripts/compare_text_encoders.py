"""Measure how well each kind of text encoder reads goals, with no images.

ReachNet's reader learns to tell which cubes and pads an instruction asks for, from the
templates for training; then it reads held-out templates:

    python scripts/compare_text_encoders.py --steps 1500

With ``--folds`` it learns from two thirds of the human templates and reads the rest:
that is what options are chosen by, so that the unseen templates stay unseen.
"""

import argparse
import time
from collections.abc import Collection, Iterator
from itertools import product
from typing import get_args

import numpy as np
import torch

from lemma.core.seeding import stream
from lemma.policies.models.reachnet.goal_reader import GoalReader, goal_numbers
from lemma.policies.text.encoder import TextConfig, TextKind
from lemma.policies.text.paraphrase import ParaphraseConfig, paraphrase
from lemma.scene.palette import OBJECT_COLORS
from lemma.tasks.language.bank import templates
from lemma.tasks.language.template import GoalPairs, Template
from lemma.tasks.suite import SUITE

NATIVE = ParaphraseConfig(
    native=1.0, clause_dropped=0.0, clause_added=0.0, swapped=0.0, left_out=0.0
)
"""Templates as they stand."""
Said = tuple[str, Template]
KINDS: tuple[TextKind, ...] = get_args(TextKind)


def held(kinds: tuple[str, ...], numbers: Collection[int]) -> list[Said]:
    """Return the templates of some kinds with their tasks, chosen by number."""
    return [
        (task, template)
        for task, kind in product(SUITE, kinds)
        for number, template in enumerate(templates(task, kind))
        if number in numbers
    ]


def draw_goal(template: Template, rng: np.random.Generator) -> GoalPairs:
    """Draw a goal of a template's shape; no entity occurs twice."""
    assert template.entity_kinds is not None
    left = {
        kind: list(rng.permutation(list(OBJECT_COLORS))) for kind in ("cube", "pad")
    }
    return tuple(
        (f"{left[top].pop()}_{top}", f"{left[bottom].pop()}_{bottom}")
        for top, bottom in template.entity_kinds
    )


def draw_batch(
    taught: list[Said], size: int, config: ParaphraseConfig, rng: np.random.Generator
) -> tuple[list[str], list[GoalPairs]]:
    """Draw sentences for training and their goals."""
    texts, goals = [], []
    used = [template for _, template in taught]
    for number in rng.integers(len(taught), size=size):
        task, template = taught[number]
        goal = draw_goal(template, rng)
        texts.append(paraphrase(task, goal, rng, config, used))
        goals.append(goal)
    return texts, goals


def accuracy(
    reader: GoalReader, asked: list[Said], draws: int
) -> dict[str, dict[str, float]]:
    """Return how often all of a goal is read, by task and template."""
    reader.eval()
    found: dict[str, dict[str, float]] = {}
    rng = stream("compare", "goals")
    for task, template in asked:
        goals = [draw_goal(template, rng) for _ in range(draws)]
        read = reader.read([template.render(goal) for goal in goals])
        right = (read == goal_numbers(goals, read.device)).flatten(1).all(1)
        found.setdefault(task, {})[template.text] = float(right.float().mean())
    reader.train()
    return found


def mean(scores: dict[str, dict[str, float]]) -> float:
    """Return the mean over tasks of the mean over templates."""
    return float(np.mean([np.mean(list(of.values())) for of in scores.values()]))


def runs(options: argparse.Namespace) -> Iterator[tuple[str, list[Said], list[Said]]]:
    """Yield what is taught and what is asked."""
    every = range(10)
    if not options.folds:
        taught = held(("high_level", "human"), every)
        yield "unseen", taught, held(("unseen",), every)
    for fold in range(options.folds):
        asked = set(every[fold::3])
        taught = held(("high_level",), every)
        taught += held(("human",), set(every) - asked)
        yield f"fold {fold}", taught, held(("human",), asked)


def train(
    kind: TextKind,
    config: ParaphraseConfig,
    taught: list[Said],
    options: argparse.Namespace,
) -> GoalReader:
    """Return a reader that has learned."""
    torch.manual_seed(options.seed)
    rng = stream("compare", options.seed)
    text = TextConfig(kind=kind, width=options.width)
    reader = GoalReader(text).to(options.device)
    optimiser = torch.optim.AdamW(reader.parameters(), 1e-3, weight_decay=0.05)
    rates = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, options.rate, total_steps=options.steps, pct_start=0.1
    )
    for _ in range(options.steps):
        texts, goals = draw_batch(taught, options.batch, config, rng)
        loss = reader.loss(texts, goal_numbers(goals, torch.device(options.device)))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(reader.parameters(), 1.0)
        optimiser.step()
        rates.step()
    return reader


def main() -> None:
    """Train and measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--texts", nargs="+", default=["templates", "paraphrases"])
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--width", type=int, default=128)
    parser.add_argument("--rate", type=float, default=1.5e-3)
    parser.add_argument("--draws", type=int, default=20, help="goals per template")
    parser.add_argument("--folds", type=int, default=0, choices=range(4))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--misread", action="store_true", help="list the templates")
    options = parser.parse_args()
    for kind, texts in product(options.kinds, options.texts):
        config = NATIVE if texts == "templates" else ParaphraseConfig()
        for name, taught, asked in runs(options):
            start = time.perf_counter()
            reader = train(kind, config, taught, options)
            scores = accuracy(reader, asked, options.draws)
            known = mean(accuracy(reader, taught, 4))
            seconds = time.perf_counter() - start
            print(
                f"{kind:14} {texts:12} taught {known:6.1%}  {name} {mean(scores):6.1%}"
                f"  ({seconds:.0f} s)",
                flush=True,
            )
            for task, by_template in scores.items() if options.misread else ():
                for template, score in by_template.items():
                    if score < 0.8:
                        print(f"    {score:4.0%} {task}: {template}")


if __name__ == "__main__":
    main()
