"""Policies compared with published lines: sub-tasks, outcomes and poses.

Pictures of another renderer move the poses of a network by some millimetres, and a few
decisions with them, so poses have a tolerance; all else must be equal.
"""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import temporary_folder
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
    with temporary_folder() as folder:
        plan = Reproduction(out=folder, episodes=episodes)
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
    judged = ("success", "failure", "progress")
    yield from _unequal(line, now, "", ("instruction", "team", *judged))
    yield from _unequal(line["lenient"], now["lenient"], "leniently, ", judged)
    before, after = _subtasks(line), _subtasks(now)
    if len(before) != len(after):
        yield f"{len(before)} sub-tasks, now {len(after)}"
    for number, (old, new) in enumerate(zip(before, after, strict=False), 1):
        where = f"sub-task {number}: "
        yield from _unequal(old, new, where, (*_SYMBOLS, "outcome"))
        posed, poses = old["grounded"], new["grounded"]
        if (posed is None) != (poses is None):
            yield f"{where}poses were {posed}, are {poses}"
        for end, (shift_m, turn_rad) in _shifts(old, new):
            if shift_m > TOLERANCE_M or turn_rad > TOLERANCE_RAD:
                moved = f"{1e3 * shift_m:.2f} mm and {turn_rad:.4f} rad"
                yield f"{where}its {end} moved by {moved}"


_SYMBOLS = ("robot", "primitive", "pick", "place")


def _unequal(old: Row, new: Row, where: str, names: Iterable[str]) -> Iterator[str]:
    for name in names:
        if old[name] != new[name]:
            yield f"{where}{name} was {old[name]}, is {new[name]}"


def _shifts(old: Row, new: Row) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield by how far the poses (x, y, yaw) of a sub-task moved [m], and turned."""
    if old["grounded"] and new["grounded"]:
        for end in ("pick", "place"):
            one, other = old["grounded"][end], new["grounded"][end]
            turn_rad = math.remainder(other[2] - one[2], 2 * math.pi)
            yield end, (math.dist(one[:2], other[:2]), abs(turn_rad))


def _subtasks(line: Row) -> list[Row]:
    return [*line["subtasks"], *line["lenient"]["subtasks"]]


def _farthest(line: Row, now: Row) -> float:
    pairs = zip(_subtasks(line), _subtasks(now), strict=False)
    shifts = (shift_m for pair in pairs for _, (shift_m, _) in _shifts(*pair))
    return max(shifts, default=0.0)
