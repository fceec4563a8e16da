"""Check that shipped policies still decide as the committed lines say.

    python scripts/check_results.py                      # whatever has lines
    python scripts/check_results.py reachnet --episodes 5 --kinds high_level

Plays the first episodes of every task with the weights that ship, and compares each
with its line in ``results/NAME/seed-0.jsonl.xz``:
sub-tasks, outcomes, success and why not must be equal, poses within 1 mm and 0.01 rad.
Leaves with 1 if anything differs, and prints what.

Images of another renderer (some lines of the learned policies were made with a graphics
card) move poses by some millimetres, and a few decisions with them; see
docs/determinism.md. To see whether a change of the code does, write lines with the code
before it, on the same machine, and compare with those:

    lemma reproduce reachnet --episodes 5 --out before
    python scripts/check_results.py reachnet --lines before
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lemma.core.errors import DatasetError
from lemma.core.workers.pool import ProcessPool
from lemma.core.workers.resources import usable_cores
from lemma.evaluation.experiments.catalog import CONTROL_LEVEL, EXPERIMENTS, SEEDS
from lemma.evaluation.experiments.reproduction import Reproduction
from lemma.evaluation.lines import lines_at, packed_beside, read_lines
from lemma.evaluation.records import Row, key_of
from lemma.evaluation.run.evaluate import EvaluationConfig, evaluate
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE

ROOT = Path(__file__).parents[1]
RESULTS = "results"
LEROBOT_PACKAGE = "lerobot"
SHIPPED = SEEDS[0]
"""Seed of the weights that ship."""
TOLERANCE_M = 0.001
TOLERANCE_RAD = 0.01


def committed(root: Path) -> dict[str, Path]:
    """Return all lines of policies whose weights ship, by what they are called here."""
    results = root / RESULTS
    found = {
        name: packed_beside(EXPERIMENTS[name].summary_path(results, SHIPPED))
        for name in EXPERIMENTS
    }
    return {name: path for name, path in found.items() if path.is_file()}


def playable(name: str) -> bool:
    """Return whether what a policy needs is installed here; say so if it is not."""
    elsewhere = name in EXPERIMENTS and EXPERIMENTS[name].suite == CONTROL_LEVEL
    if elsewhere and find_spec(LEROBOT_PACKAGE) is None:
        print(f"{name}: left out, because lerobot is not installed here")
        return False
    return True


def order_of(name: str, path: Path, out: Path, episodes: int) -> EvaluationConfig:
    """Return how what is committed was played.

    Args:
        name: Of an experiment.
        path: Its lines.
        out: Folder to play into.
        episodes: Of each task.
    """
    order, seed = Reproduction(out=out, episodes=episodes).config(EXPERIMENTS[name])
    if seed != SHIPPED:
        raise DatasetError(f"Weights of {name} ship with seed {seed}.")
    return order


def differences(line: Row, now: Row) -> Iterator[str]:
    """Yield in what an episode differs from its line, in words.

    Args:
        line: What is committed.
        now: What was played.
    """
    for name in ("instruction", "team", "success", "failure", "progress"):
        if line[name] != now[name]:
            yield f"{name} was {line[name]!r}, is {now[name]!r}"
    for name in ("success", "failure", "progress"):
        old, new = line["lenient"][name], now["lenient"][name]
        if old != new:
            yield f"leniently, {name} was {old!r}, is {new!r}"
    before, after = subtasks_of(line), subtasks_of(now)
    if len(before) != len(after):
        yield f"{len(before)} sub-tasks, now {len(after)}"
    for number, (old, new) in enumerate(zip(before, after, strict=False), 1):
        for name in ("robot", "primitive", "pick", "place", "outcome"):
            if old[name] != new[name]:
                yield f"sub-task {number}: {name} was {old[name]}, is {new[name]}"
        posed, poses = old["grounded"], new["grounded"]
        if (posed is None) != (poses is None):
            yield f"sub-task {number}: poses were {posed}, are {poses}"
        elif posed is not None:
            for end in ("pick", "place"):
                shift_m, turn_rad = shift_of(posed[end], poses[end])
                if shift_m > TOLERANCE_M or turn_rad > TOLERANCE_RAD:
                    yield (
                        f"sub-task {number}: its {end} moved by {1e3 * shift_m:.2f} mm "
                        f"and {turn_rad:.4f} rad"
                    )


def subtasks_of(line: Row) -> list[dict[str, Any]]:
    """Return all sub-tasks of an episode, also those after a protective stop."""
    return [*line["subtasks"], *line["lenient"]["subtasks"]]


def shift_of(old: Sequence[float], new: Sequence[float]) -> tuple[float, float]:
    """Return by how far a pose (x, y, yaw) moved [m], and turned [rad]."""
    turn = math.remainder(new[2] - old[2], 2 * math.pi)
    return math.dist(old[:2], new[:2]), abs(turn)


def largest_shift(line: Row, now: Row) -> float:
    """Return by how far any pose of an episode moved [m]."""
    shifts = [
        shift_of(old["grounded"][end], new["grounded"][end])[0]
        for old, new in zip(subtasks_of(line), subtasks_of(now), strict=False)
        if old["grounded"] and new["grounded"]
        for end in ("pick", "place")
    ]
    return max(shifts, default=0.0)


def check(name: str, path: Path, asked: argparse.Namespace) -> int:
    """Play episodes of what is committed; print and count those that differ.

    Args:
        name: What it is called here.
        path: Its lines.
        asked: What the command line says.
    """
    source = lines_at(asked.lines / name) if asked.lines else path
    lines = {key_of(row): row for row in read_lines(source)}
    kinds = tuple(k for k in asked.kinds if k in {kind for kind, _, _ in lines})
    tasks = tuple(t for t in asked.tasks if t in {task for _, task, _ in lines})
    with tempfile.TemporaryDirectory() as folder:
        order = order_of(name, path, Path(folder), asked.episodes)
        order = replace(order, tasks=tasks, kinds=kinds)
        rows = evaluate(order, ProcessPool(asked.workers))
    differing = 0
    for row in rows:
        found = list(differences(lines[key_of(row)], row))
        differing += bool(found)
        for one in found:
            print(f"{name} {' '.join(map(str, key_of(row)))}: {one}")
    shift_mm = 1e3 * max(largest_shift(lines[key_of(row)], row) for row in rows)
    timed = max(abs(lines[key_of(row)]["elapsed_s"] - row["elapsed_s"]) for row in rows)
    print(
        f"{name}: {differing} of {len(rows)} episodes differ; poses moved by at most "
        f"{shift_mm:.4f} mm, ends by {timed:.3f} s",
        flush=True,
    )
    return differing


def main() -> int:
    """Do what the command line says."""
    found = committed(ROOT)
    parser = argparse.ArgumentParser(description="Policies against committed lines.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(found))
    parser.add_argument("--episodes", type=int, default=5, help="of every task")
    parser.add_argument("--tasks", nargs="+", default=SUITE, choices=SUITE)
    parser.add_argument(
        "--kinds", nargs="+", default=EVALUATION_KINDS[:1], choices=EVALUATION_KINDS
    )
    parser.add_argument("--lines", type=Path, help="folder of NAME/... with lines")
    parser.add_argument("--workers", type=int, default=usable_cores())
    asked = parser.parse_args()
    if unknown := sorted(set(asked.names) - set(found)):
        parser.error(f"no lines of {', '.join(unknown)}; there are {', '.join(found)}")
    if not found:
        parser.error("nothing is committed that could be checked")
    names = asked.names or [name for name in found if playable(name)]
    return min(sum(check(name, found[name], asked) for name in names), 1)


if __name__ == "__main__":
    sys.exit(main())
