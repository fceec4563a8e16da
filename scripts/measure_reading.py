r"""Train ReachNet's reader of sentences alone, without images, and measure it.

    python scripts/measure_reading.py --steps 1500

It trains on templates and paraphrases of random goals. Then it reads the sentences of
``tests/policies/sentences/voices.toml``, which are in no training data, with and
without the information about which objects are in the scene. ``--without step cleft``
leaves out rules of the grammar, to measure the generalisation to other sentence forms.
``--unseen`` also reads the held-out templates; do not choose options with these.

    python scripts/measure_reading.py --teach runs/seed-0/reachnet --steps 8000 \
        --batch 128 --rate 6e-4 --refusals 0.4

teaches the reader of a training of ReachNet further. Nothing else in its weights
changes.
"""

import argparse
import sys
import time
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.models.reachnet.goal_reader import (
    GoalReader,
    ReaderConfig,
)
from lemma.policies.models.reachnet.model import ReachNet
from lemma.policies.models.reachnet.understanding import goal_numbers
from lemma.policies.text.grammar import Grammar, grammar
from lemma.policies.text.orders import draw_goal, pair_kinds
from lemma.policies.text.paraphrase import paraphrase
from lemma.policies.text.refusals import refusal_bank
from lemma.policies.training.run import WEIGHTS
from lemma.policies.weights import load_model
from lemma.policies.weights_file import read_metadata, write_weights
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.language.bank import instruct, templates
from lemma.tasks.language.template import GoalPairs, Template
from lemma.tasks.suite import SUITE

VOICES = Path(__file__).parents[1] / "tests" / "policies" / "sentences" / "voices.toml"
FAMILIES = {
    "pad": (("cube", "pad"),),
    "cube": (("cube", "cube"),),
    "pads": (("cube", "pad"),) * 2,
    "cubes": (("cube", "cube"),) * 2,
}
_EMA = 0.998
_POOLED = 8
"""Number of batches whose sentences are sorted by length together."""
Asked = tuple[str, Template]
CPU = torch.device("cpu")


def draw_scene(goal: GoalPairs, rng: np.random.Generator) -> Tensor:
    """Return the entities of a scene with up to 3 distractors, (entities,) bool."""
    present = torch.zeros(len(ENTITIES), dtype=torch.bool)
    present[[ENTITIES.index(name) for pair in goal for name in pair]] = True
    colored = [i for i, name in enumerate(ENTITIES) if name != "stick"]
    others = rng.permutation([i for i in colored if not present[i]])
    present[others[: int(rng.integers(0, 4))].tolist()] = True
    return present


def batches(
    rules: Grammar, options: argparse.Namespace
) -> Iterator[tuple[list[str], Tensor, Tensor]]:
    """Yield sentences, their goals, and the reasons for refusal."""
    rng, bank = stream("reading", options.seed), refusal_bank()
    for _ in range(-(-options.steps // _POOLED)):
        pool = []
        for _ in range(_POOLED * options.batch):
            if rng.random() < options.refusals:
                pool.append(bank.draw(rng))
                continue
            task = SUITE[int(rng.integers(len(SUITE)))]
            goal = draw_goal(pair_kinds(task), rng)
            if rng.random() < options.paraphrases:
                text = paraphrase(task, goal, rng, rules=rules)
            else:
                kind = ("high_level", "human")[int(rng.integers(2))]
                text = instruct(task, kind, goal, rng)
            pool.append((text, goal, -1))
        pool.sort(key=lambda said: len(said[0]))
        for start in rng.permutation(_POOLED) * options.batch:
            part = pool[start : start + options.batch]
            texts = [text for text, _, _ in part]
            goals = goal_numbers([goal for _, goal, _ in part], CPU)
            yield texts, goals, torch.tensor([reason for _, _, reason in part])


def train(rules: Grammar, options: argparse.Namespace) -> GoalReader:
    """Return a trained reader."""
    torch.manual_seed(options.seed)
    reader = GoalReader(ReaderConfig())
    # Not by name: published weights stay as they are.
    start = str(options.teach / WEIGHTS) if options.teach else options.start
    if start:
        found = load_model(start)
        assert isinstance(found, ReachNet)
        # Parts that are missing in older weights keep their initial values.
        reader.load_state_dict(found.reader.state_dict(), strict=False)
    optimizer = torch.optim.AdamW(reader.parameters(), options.rate, weight_decay=0.02)
    steps = -(-options.steps // _POOLED) * _POOLED
    rates = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, options.rate, total_steps=steps, pct_start=0.1
    )
    average = deepcopy(reader).eval()
    begin, mean = time.perf_counter(), 0.0
    for step, (texts, *wanted) in enumerate(batches(rules, options), 1):
        loss = reader.loss(texts, *wanted)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(reader.parameters(), 1.0)
        optimizer.step()
        rates.step()
        # As in the training of models.
        decay = min(_EMA, (1 + step) / (10 + step))
        with torch.no_grad():
            for old, new in zip(average.parameters(), reader.parameters(), strict=True):
                old.lerp_(new, 1.0 - decay)
        mean += (loss.item() - mean) * max(0.02, 1 / step)
        if step % 200 == 0:
            seconds = time.perf_counter() - begin
            print(f"{step:6} loss {mean:.3f} ({seconds:.0f} s)", flush=True)
    return average


def replace_reader(run: Path, reader: GoalReader) -> None:
    """Replace the reader in the weights of a run, and add the command to them."""
    path = run / WEIGHTS
    network = load_model(str(path))
    assert isinstance(network, ReachNet)
    network.reader.load_state_dict(reader.state_dict())
    metadata = read_metadata(path)
    command = f"python scripts/{Path(__file__).name} {' '.join(sys.argv[1:])}"
    metadata = replace(metadata, command=f"{metadata.command}; {command}", packed={})
    write_weights(path, network.eval().state_dict(), metadata)


def measure(
    reader: GoalReader, asked: list[Asked], draws: int, *, scenes: bool
) -> dict[Asked, float]:
    """Return how often the whole goal is right, by group and template."""
    rng = stream("reading", "asked")
    found = {}
    for group, template in asked:
        assert template.entity_kinds is not None
        goals = [draw_goal(template.entity_kinds, rng) for _ in range(draws)]
        present = torch.stack([draw_scene(goal, rng) for goal in goals])
        texts = [template.render(goal) for goal in goals]
        read, _ = reader.read(texts, present if scenes else None)
        want = goal_numbers(goals, CPU)
        right = (torch.stack([want, want.flip(1)]) == read).flatten(2).all(2).any(0)
        found[group, template] = float(right.float().mean())
    return found


def voices() -> list[Asked]:
    """Return the sentences of the voices, each with its voice."""
    return [
        (f"{voice} {family}", Template.from_string(text, FAMILIES[family]))
        for voice, families in tomllib.loads(VOICES.read_text(encoding="utf-8")).items()
        for family, texts in families.items()
        for text in texts
    ]


def report(title: str, scores: dict[Asked, float], low: float) -> None:
    """Print the means by each word of the groups, and the worst templates."""
    groups: dict[str, list[float]] = defaultdict(list)
    for (group, _), score in scores.items():
        for word in group.split():
            groups[word].append(score)
    means = " ".join(f"{name} {np.mean(of):.0%}" for name, of in groups.items())
    print(f"{title}: {np.mean(list(scores.values())):.1%} ({means})", flush=True)
    for (group, template), score in scores.items():
        if score < low:
            print(f"    {score:4.0%} {group}: {template.text}")


def main() -> None:
    """Train or load a reader, and measure it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rate", type=float, default=1.5e-3)
    parser.add_argument("--paraphrases", type=float, default=0.7)
    parser.add_argument("--refusals", type=float, default=0.18)
    parser.add_argument("--start", help="weights of ReachNet to go on from")
    parser.add_argument("--teach", type=Path, help="the same, a run to write them to")
    parser.add_argument("--without", nargs="*", default=[], help="rules left out")
    parser.add_argument("--draws", type=int, default=8, help="goals per sentence")
    parser.add_argument("--misread", type=float, default=0.0, help="list those below")
    parser.add_argument("--unseen", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--weights", type=Path, help="read by these, or write them")
    options = parser.parse_args()
    if options.teach and not (options.teach / WEIGHTS).is_file():
        parser.error(f"{options.teach} has no {WEIGHTS}: name the folder of a training")
    if options.teach and (options.weights or options.start):
        parser.error("--teach reads and writes the weights of its run; no others")
    torch.set_num_threads(1)
    rules = grammar()
    if options.without:
        source = files("lemma.policies.text") / "data" / "grammar.toml"
        sections = tomllib.loads(source.read_text(encoding="utf-8")).values()
        rules = Grammar(
            {k: v for section in sections for k, v in section.items()}, options.without
        )
    if options.weights and options.weights.exists():
        reader = GoalReader(ReaderConfig()).eval()
        reader.load_state_dict(torch.load(options.weights))
    else:
        reader = train(rules, options)
        if options.weights:
            torch.save(reader.state_dict(), options.weights)
        if options.teach:
            replace_reader(options.teach, reader)
    report("voices", measure(reader, voices(), options.draws, scenes=False), 0.0)
    known = measure(reader, voices(), options.draws, scenes=True)
    report("voices, on a table", known, options.misread)
    if options.unseen:
        asked = [(task, t) for task in SUITE for t in templates(task, "unseen")]
        report("unseen", measure(reader, asked, options.draws, scenes=False), 0.0)
        report("unseen, on a table", measure(reader, asked, 8, scenes=True), 0.0)


if __name__ == "__main__":
    main()
