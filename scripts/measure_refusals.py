"""Measure the refusals of a reader, and the calibration of its certainty.

    python scripts/measure_refusals.py reachnet

The orders are the human and unseen templates of the benchmark, the voices, and orders
of the evaluation bank. The sentences to refuse are from that bank
(``tests/policies/sentences/refusals.toml``). Each has random colors, in a scene with up
to three distractors. The first table has the shares of right, wrong and refused
readings; the second one has the accuracy by certainty, the expected calibration
error, and the mean negative log-likelihood.
``--fit`` prints the temperature that fits the held-out lines and the voices.
``--kept`` reads these instead of the evaluation bank and templates, to choose options.
``--as-before`` refuses by the rule for readers without refusals: certainty below 50 %,
or the word "not". They had no temperature: it is 1 unless ``--temperature`` is given.
"""

import argparse
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from lemma.core.seeding import stream
from lemma.policies.models.reachnet.goal_reader import (
    GoalReader,
    ReaderConfig,
)
from lemma.policies.models.reachnet.model import ReachNet
from lemma.policies.models.reachnet.understanding import goal_numbers
from lemma.policies.text.orders import draw_goal
from lemma.policies.text.refusals import RefusalBank, goal_for, refusal_bank
from lemma.policies.weights import load_model
from lemma.tasks.language.bank import templates
from lemma.tasks.language.blind import blind_templates
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.suite import SUITE
from measure_reading import FAMILIES, draw_scene, voices

BANK = Path(__file__).parents[1] / "tests" / "policies" / "sentences" / "refusals.toml"
ORDERS = ("human", "unseen", "blind", "voices", "contrast", "own", "plain")
_DENIES = re.compile(r"\b(?:not|never|cannot|dont|nor)\b|n['\u2019]t\b", re.IGNORECASE)
_EDGES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


class Said(NamedTuple):
    """A sentence with its right reading."""

    group: str
    text: str
    goal: GoalPairs
    """The goal; empty for a sentence to refuse."""


class Answers(NamedTuple):
    """Readings of sentences."""

    right: torch.Tensor
    refused: torch.Tensor
    stops: torch.Tensor
    """Whether the policy stops, whose threshold is higher than that of a refusal."""
    certainty: torch.Tensor


def orders(draws: int, *, blind: bool = False) -> Iterator[Said]:
    """Yield orders of the benchmark and of the voices."""
    rng = stream("refusals", "orders")
    for kind in ("human", "unseen", *(["blind"] if blind else [])):
        for task in SUITE:
            known = blind_templates(task) if kind == "blind" else templates(task, kind)
            for template in known:
                for _ in range(draws):
                    assert template.entity_kinds is not None
                    goal = draw_goal(template.entity_kinds, rng)
                    yield Said(kind, template.render(goal), goal)
    for _, template in voices():
        for _ in range(draws):
            assert template.entity_kinds is not None
            goal = draw_goal(template.entity_kinds, rng)
            yield Said("voices", template.render(goal), goal)


def asked(bank: RefusalBank, draws: int) -> Iterator[Said]:
    """Yield the sentences of a bank."""
    rng = stream("refusals", "bank")
    for group, lines in (*bank.refused.items(), *bank.orders.items()):
        for line in lines:
            for _ in range(draws):
                goal = goal_for(line, rng) if group in bank.orders else ()
                if group == "own":
                    cube = goal[0][0]
                    goal = ((cube, cube.replace("_cube", "_pad")),)
                yield Said(group, bank.render(line, rng, goal), goal)


def kept(draws: int) -> list[Said]:
    """Return the sentences for choosing options: held-out lines and voices."""
    said = [one for one in orders(draws) if one.group == "voices"]
    return [*said, *asked(refusal_bank(kept=True), draws)]


def answers(reader: GoalReader, said: list[Said], *, as_before: bool) -> Answers:
    """Return a reader's readings of sentences in random scenes."""
    rng = stream("refusals", "tables")
    found: list[tuple[bool, bool, bool, float]] = []
    for start in range(0, len(said), 64):
        part = said[start : start + 64]
        tables = torch.stack([draw_scene(one.goal or _any(rng), rng) for one in part])
        read = reader.weigh([one.text for one in part], tables)
        want = goal_numbers([one.goal for one in part], torch.device("cpu"))
        got = read.goals[:, 0]
        same = (torch.stack([want, want.flip(1)]) == got).flatten(2).all(2).any(0)
        for row, one in enumerate(part):
            no, sure = bool(read.reasons[row] >= 0), float(read.shares[row, 0])
            if as_before:
                no = sure < 0.5 or _DENIES.search(one.text) is not None
            elif no:
                sure = float(read.refused[row])
            right = bool(one.goal) and bool(same[row])
            if not as_before:
                # By the earlier rule the certainty is that of the goal alone.
                right = no if not one.goal else right and not no
            stops = float(read.refused[row]) >= reader.config.refuse_from
            found.append((right, no, stops and not as_before, sure))
    columns = list(zip(*found, strict=True))
    return Answers(*(torch.tensor(column) for column in columns))


def _any(rng: np.random.Generator) -> GoalPairs:
    return draw_goal(FAMILIES["pads" if rng.random() < 0.5 else "cubes"], rng)


def ece(found: Answers) -> float:
    """Return the expected calibration error, with ten bins of equal width."""
    bins = (found.certainty * 10).long().clamp(max=9)
    error = 0.0
    for number in range(10):
        here = bins == number
        if here.any():
            gap = found.right[here].double().mean() - found.certainty[here].mean()
            error += float(gap.abs()) * float(here.double().mean())
    return error


def surprise(found: Answers) -> float:
    """Return the mean negative log-likelihood of what is right, by the certainty."""
    sure = found.certainty.double().clamp(1e-6, 1 - 1e-6)
    return float(-torch.where(found.right, sure.log(), (1 - sure).log()).mean())


def report(said: list[Said], found: Answers) -> None:
    """Print both tables."""
    rows: dict[str, list[int]] = defaultdict(list)
    for row, one in enumerate(said):
        rows[one.group].append(row)
    totals: dict[str, list[int]] = {"orders": [], "no orders": []}
    for group, numbers in rows.items():
        totals["orders" if group in ORDERS else "no orders"] += numbers
    print("sentences         n   right  refused  wrong act    stops")
    for group, numbers in (*rows.items(), *totals.items()):
        refused = found.refused[numbers].double().mean().item()
        stops = found.stops[numbers].double().mean().item()
        order = group in ORDERS or group == "orders"
        acted = found.right[numbers] & ~found.refused[numbers]
        right = acted.double().mean().item() if order else refused
        wrong = (1 - refused) - (right if order else 0.0)
        shares = f"{right:7.1%} {refused:8.1%} {wrong:10.1%} {stops:8.1%}"
        print(f"{group:12} {len(numbers):6} {shares}")
    print(f"\n{'certainty':>12} {'n':>6} {'right':>7} {'mean certainty':>15}")
    for low, high in pairwise(_EDGES):
        sure = found.certainty
        here = (sure >= low) & ((sure < high) | (high == 1.0))
        if here.any():
            right = float(found.right[here].double().mean())
            mean = float(sure[here].mean())
            share = f"{low:.0%} to {high:.0%}"
            print(f"{share:>12} {int(here.sum()):6} {right:7.1%} {mean:15.1%}")
    sure = found.certainty >= 0.9
    if sure.any():
        print(f"{'90 % or more':>12} {int(sure.sum()):6} ", end="")
        print(f"{found.right[sure].double().mean():7.1%}")
    print(f"expected calibration error {ece(found):.3f}")
    print(f"mean negative log-likelihood {surprise(found):.3f}")


def fitted(reader: GoalReader) -> float:
    """Return the most likely temperature for held-out lines and voices."""
    said = kept(12)
    config, best = reader.config, (np.inf, 1.0)
    for value in np.arange(0.6, 4.05, 0.1).tolist():
        reader.config = replace(config, temperature=value)
        loss = surprise(answers(reader, said, as_before=False))
        best = min(best, (loss, value))
    reader.config = config
    return best[1]


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weights", help="of ReachNet, by name or file")
    parser.add_argument("--reader", type=Path, help="a reader by measure_reading.py")
    parser.add_argument("--draws", type=int, default=8, help="of each sentence")
    parser.add_argument("--temperature", type=float)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--as-before", action="store_true")
    parser.add_argument(
        "--kept", action="store_true", help="lines kept from training, and voices alone"
    )
    parser.add_argument("--blind", action="store_true", help="blind orders, unlisted")
    parser.add_argument("--list", action="store_true", help="print what is wrong")
    options = parser.parse_args()
    torch.set_num_threads(1)
    model = load_model(options.weights)
    assert isinstance(model, ReachNet)
    reader = model.reader
    if options.reader:
        reader = GoalReader(ReaderConfig()).eval()
        reader.load_state_dict(torch.load(options.reader))
    if options.temperature or options.as_before:
        temperature = options.temperature or 1.0
        reader.config = replace(reader.config, temperature=temperature)
    if options.fit:
        value = fitted(reader)
        print(f"temperature {value:.1f}")
        reader.config = replace(reader.config, temperature=value)
    if options.kept:
        said = kept(options.draws)
    else:
        bank = RefusalBank.of(tomllib.loads(BANK.read_text(encoding="utf-8")))
        said = [*orders(options.draws, blind=options.blind)]
        said += asked(bank, options.draws)
    found = answers(reader, said, as_before=options.as_before)
    report(said, found)
    if options.list:
        for one, right, sure in zip(said, found.right, found.certainty, strict=True):
            if not right and one.group != "blind":
                print(f"{sure:4.0%} {one.group}: {one.text}")


if __name__ == "__main__":
    main()
