"""Policies compared with published lines: sub-tasks, outcomes and poses.

Pictures of another renderer move the poses of a network by some millimetres, and a few
decisions with them, so poses have a tolerance; all else must be equal.
"""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.workers.pool import Engine
from lemma.evaluation.experiments.catalog import SEEDS, Experiment
from lemma.evaluation.experiments.reproduction import Reproduction
from lemma.evaluation.lines import lines_at, packed_beside, read_lines
from lemma.evaluation.records import Row, key_of
from lemma.evaluation.run.evaluate import evaluate

SAMPLE = "published.json"
"""File in the package with some published lines, by policy."""
SHIPPED = SEEDS[0]
"""Training seed of the weights that ship."""
TOLERANCE_M = 0.001
TOLERANCE_RAD = 0.01


@dataclass(frozen=True)
class Agreement:
    """How episodes that were played anew agree with their lines."""

    episodes: int
    differing: tuple[str, ...]
    """Differences of each episode that differs, in words."""
    farthest_m: float
    """By how far a pose moved at most [m]."""

    @property
    def ok(self) -> bool:
        """Whether all agree."""
        return not self.differing


def published_sample() -> dict[str, list[Row]]:
    """Return some published lines by policy, from the package."""
    text = (files("lemma.evaluation.experiments") / SAMPLE).read_text("utf-8")
    found: dict[str, list[Row]] = json.loads(text)
    return found


def check_experiment(
    experiment: Experiment, results: Path, episodes: int, engine: Engine
) -> Agreement:
    """Play some episodes with the weights that ship, and compare with published lines.

    Args:
        experiment: Which row.
        results: Folder of published results.
        episodes: How many of each task and kind of instruction.
        engine: Workers that run the jobs.

    Raises:
        DatasetError: There are no lines of it, or its weights are missing.
    """
    path = packed_beside(experiment.summary_path(results, SHIPPED))
    if not path.is_file():
        # Lines that were just played lie in a folder.
        path = lines_at(experiment.summary_path(results, SHIPPED).with_suffix(""))
    lines = {key_of(row): row for row in read_lines(path)}
    with TemporaryDirectory() as folder:
        plan = Reproduction(out=Path(folder), episodes=episodes)
        config, seed = plan.config(experiment)
        if seed != SHIPPED:
            raise DatasetError(f"Weights of {experiment.name} ship with seed {seed}.")
        tasks = tuple(t for t in config.tasks if t in {task for _, task, _ in lines})
        kinds = tuple(k for k in config.kinds if k in {kind for kind, _, _ in lines})
        rows = evaluate(replace(config, tasks=tasks, kinds=kinds), engine)
    return compared([(lines[key_of(row)], row) for row in rows if key_of(row) in lines])


def compared(pairs: Sequence[tuple[Row, Row]]) -> Agreement:
    """Compare lines with what was played anew.

    Raises:
        InvalidConfigError: There is nothing to compare.
    """
    if not pairs:
        raise InvalidConfigError("No episode that was played has a published line.")
    differing = tuple(
        f"{'/'.join(map(str, key_of(line)))}: {'; '.join(found)}"
        for line, now in pairs
        if (found := list(_differences(line, now)))
    )
    return Agreement(len(pairs), differing, max(_farthest(*pair) for pair in pairs))


def _differences(line: Row, now: Row) -> Iterator[str]:
    """Yield in what an episode differs from its line, in words."""
    for name in ("instruction", "team", "success", "failure", "progress"):
        if line[name] != now[name]:
            yield f"{name} was {line[name]!r}, is {now[name]!r}"
    for name in ("success", "failure", "progress"):
        old, new = line["lenient"][name], now["lenient"][name]
        if old != new:
            yield f"leniently, {name} was {old!r}, is {new!r}"
    before, after = _subtasks(line), _subtasks(now)
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
                shift_m, turn_rad = _shift(posed[end], poses[end])
                if shift_m > TOLERANCE_M or turn_rad > TOLERANCE_RAD:
                    yield (
                        f"sub-task {number}: its {end} moved by {1e3 * shift_m:.2f} mm "
                        f"and {turn_rad:.4f} rad"
                    )


def _subtasks(line: Row) -> list[dict[str, Any]]:
    return [*line["subtasks"], *line["lenient"]["subtasks"]]


def _shift(old: Sequence[float], new: Sequence[float]) -> tuple[float, float]:
    """Return by how far a pose (x, y, yaw) moved [m], and turned [rad]."""
    turn = math.remainder(new[2] - old[2], 2 * math.pi)
    return math.dist(old[:2], new[:2]), abs(turn)


def _farthest(line: Row, now: Row) -> float:
    shifts = [
        _shift(old["grounded"][end], new["grounded"][end])[0]
        for old, new in zip(_subtasks(line), _subtasks(now), strict=False)
        if old["grounded"] and new["grounded"]
        for end in ("pick", "place")
    ]
    return max(shifts, default=0.0)
