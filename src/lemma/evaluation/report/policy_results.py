"""The results of one policy over its training seeds, a row of a table."""

import json
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from statistics import fmean, stdev

from lemma.core.errors import DatasetError
from lemma.evaluation.analysis.failure_causes import (
    OF_CONTROL,
    OF_NAMES,
    OF_SUBTASKS,
    Cause,
)
from lemma.evaluation.analysis.rates import Cell, leniently, mean_over_tasks, rate_of
from lemma.evaluation.analysis.result import Result, check_lines, read_result
from lemma.evaluation.experiments.catalog import ABLATIONS, EXPERIMENTS, Experiment
from lemma.evaluation.lines import is_lines, lines_beside, read_lines, result_beside
from lemma.evaluation.protocol.language_controls import FULL
from lemma.evaluation.protocol.rules import check_protocol
from lemma.evaluation.records import SUMMARY
from lemma.policies.spec import PolicySpec
from lemma.tasks.names import SUITE, in_order

NOTHING = "–"
NOT_RUN = "not run"
PARTIAL = "†"
"""Mark of a mean that is not over all tasks of the suite."""


@dataclass(frozen=True)
class PolicyResults:
    """One policy with its result for each training seed."""

    title: str
    results: tuple[Result, ...] = ()
    """Results by seed; empty if it was not evaluated."""
    experiment: Experiment | None = None
    """Its experiment; None for a policy that is not in the registry."""

    def select(self, kind: str, **where: object) -> list[list[Cell]]:
        """Return the cells of each seed with a kind and with values of fields.

        Args:
            kind: Kind of instructions.
            where: Fields of a cell and their values, such as ``task="stack"``.
        """
        return [
            [
                cell
                for cell in result.cells
                if cell.kind == kind
                and all(getattr(cell, name) == value for name, value in where.items())
            ]
            for result in self.results
        ]

    def select_leniently(self, kind: str, **where: object) -> list[list[Cell]]:
        """As :meth:`select`, with lenient successes, without seeds that have none."""
        seeds = (leniently(cells) for cells in self.select(kind, **where))
        return [cells for cells in seeds if cells]

    def has(self, kind: str) -> bool:
        """Return whether there are episodes of a kind of instructions."""
        return any(self.select(kind))

    @property
    def suite(self) -> str:
        """Suite of its experiment; empty without an experiment."""
        return self.experiment.suite if self.experiment else ""

    def episodes(self, kind: str | None = None, task: str | None = None) -> int:
        """Return the number of episodes, by default of all kinds and tasks."""
        return sum(
            cell.episodes
            for result in self.results
            for cell in result.cells
            if kind in (None, cell.kind) and task in (None, cell.task)
        )

    def causes(self, kind: str | None = None, task: str | None = None) -> Counter[str]:
        """Return the number of failures by cause, by default of all kinds and tasks."""
        counted: Counter[str] = Counter()
        for result in self.results:
            for loss in result.losses:
                if kind in (None, loss.kind) and task in (None, loss.task):
                    counted[loss.cause] += loss.episodes
        return counted

    @cached_property
    def untold(self) -> frozenset[Cause]:
        """The causes that its episodes cannot tell, whatever happened in them.

        The expert judges sub-tasks that name objects. Without a judged one they name
        none; at control level there are none.
        """
        found = self.causes()
        if any(map(_controls, self.results)) or not OF_CONTROL.isdisjoint(found):
            return OF_SUBTASKS.difference(found)
        known = [one for result in self.results for one in result.coordination]
        if not known or any(one.judged for one in known):
            return OF_CONTROL
        return (OF_CONTROL | OF_NAMES).difference(found)


def _controls(result: Result) -> bool:
    """Return whether a policy gave motor commands."""
    policy = result.about["policy"]
    return PolicySpec(policy["name"], level=policy.get("level", "")).controls


def pooled(cells: list[Cell]) -> float:
    """Return the success rate over all episodes."""
    return rate_of(cells).success_rate


def shown(seeds: list[list[Cell]], rate: Callable[[list[Cell]], float] = pooled) -> str:
    """Return a success rate [%] as text for a table.

    Args:
        seeds: The cells of each seed.
        rate: Computes a success rate from the cells of one seed.

    Returns:
        For one seed the rate and its 95 % Wilson interval; for several seeds the mean
        and the standard deviation.
    """
    rates = [100.0 * rate(cells) for cells in seeds if cells]
    if not rates:
        return NOTHING
    if len(rates) > 1:
        return f"{fmean(rates):.1f} ± {stdev(rates):.1f}"
    counted = rate_of(next(cells for cells in seeds if cells))
    low, high = counted.interval
    return f"{rates[0]:.1f} ({100 * low:.0f}–{100 * high:.0f})"


def shown_mean(seeds: list[list[Cell]]) -> str:
    """Return the mean over the tasks [%] as text for a table.

    :data:`PARTIAL` marks a mean that is not over all tasks of the suite.
    """
    text = shown(seeds, mean_over_tasks)
    whole = all({cell.task for cell in cells} == set(SUITE) for cells in seeds if cells)
    return text if whole else f"{text} {PARTIAL}"


def tasks_of(
    entries: Iterable[PolicyResults], kind: str | None = None
) -> tuple[str, ...]:
    """Return the names of evaluated tasks, in the order of tables.

    Args:
        entries: Results by policy.
        kind: Only tasks with this kind of instructions; any if None.

    Returns:
        The names; those of the suite if there are no episodes.
    """
    played = in_order(
        cell.task
        for entry in entries
        for result in entry.results
        for cell in result.cells
        if kind in (None, cell.kind)
    )
    return played or SUITE


def read_results(paths: Iterable[Path]) -> list[Result]:
    """Read results.

    Args:
        paths: Files of results or of their lines, or folders with such files at any
            depth. Other files in folders are ignored.

    Raises:
        DatasetError: A file is missing or damaged or does not match the lines beside
            it, or results are of different protocols or splits.
    """
    results: list[Result] = []
    for path in dict.fromkeys(file for each in paths for file in _files(each)):
        result = read_result(path)
        first = results[0] if results else result
        check_protocol(result.about, first.about, path, "what was read before")
        if result.about["split"] != first.about["split"]:
            raise DatasetError(
                f"{path} is of split {result.about['split']}, and others are of "
                f"{first.about['split']}, so they cannot be compared. Report them "
                "separately."
            )
        for lines in lines_beside(path):
            check_lines(result, read_lines(lines), path, lines)
        results.append(result)
    return results


def _files(path: Path) -> list[Path]:
    if is_lines(path):
        path = result_beside(path)
    if path.is_file():
        # A shell's results/* includes the tables beside the results.
        return [path] if path.suffix == ".json" else []
    if not path.is_dir():
        raise DatasetError(
            f"There is no {path}. Name a file or folder that 'lemma evaluate' or "
            "'lemma reproduce' wrote."
        )
    return sorted(file for file in path.rglob("*.json") if _is_result(file))


def _is_result(file: Path) -> bool:
    name, folder = file.name, file.absolute().parent.name
    return name == SUMMARY or name.startswith("seed-") or folder == ABLATIONS


def entries_of(
    results: Iterable[Result], *, complete: bool = False
) -> list[PolicyResults]:
    """Return results by policy, first those of the registry, in its order.

    Results of ``lemma evaluate`` for a policy of the registry belong to its entry, too.

    Args:
        results: Results of any policies and seeds.
        complete: Whether experiments without results have an entry, too.

    Raises:
        DatasetError: A policy has two results with the same seed, or its seeds were
            trained on different data.
    """
    named: dict[str, list[Result]] = {}
    for result in results:
        named.setdefault(_row_of(result), []).append(result)
    entries = [
        PolicyResults(experiment.title, _by_seed(named.pop(name, [])), experiment)
        for name, experiment in EXPERIMENTS.items()
        if complete or name in named
    ]
    return entries + [
        PolicyResults(name, _by_seed(found)) for name, found in named.items()
    ]


def title_of(result: Result) -> str:
    """Return the title of a policy that is not in the registry."""
    policy = result.about["policy"]
    parts = [policy["name"], policy["planning"] * (policy["planning"] != "single-step")]
    parts += ["GTA" * policy["gta"]]
    if policy.get("level"):
        parts.append(f"{policy['level']} level")
    arguments = policy.get("arguments", {})
    parts += [f"{name}={value}" for name, value in arguments.items()]
    if result.about["language"] != FULL:
        parts.append(f"language {result.about['language']}")
    if starts_perturbed(result):
        parts.append("perturbed starts")
    if result.about.get("disturb"):
        parts.append(f"disturbed: {result.about['disturb']}")
    return ", ".join(part for part in parts if part)


def starts_perturbed(result: Result) -> bool:
    """Return whether a result is of perturbed starts."""
    return bool(result.about.get("perturb_start", False))


def policy_of(result: Result) -> str:
    """Return the policy of a result, independent of language control and start."""
    return json.dumps(result.about["policy"], sort_keys=True)


def is_plain(result: Result) -> bool:
    """Return whether a result has no language control, perturbation or disturbance."""
    moved = starts_perturbed(result) or bool(result.about.get("disturb"))
    return result.about["language"] == FULL and not moved


def _row_of(result: Result) -> str:
    """Return the name of a result's experiment; otherwise the policy's title."""
    if result.experiment in EXPERIMENTS:
        return result.experiment
    about = result.about
    if about.get("disturb"):
        return title_of(result)
    said = (about["policy"], about["language"], starts_perturbed(result))
    found = (name for name, one in EXPERIMENTS.items() if one.decides == said)
    return next(found, title_of(result))


def _by_seed(results: list[Result]) -> tuple[Result, ...]:
    ordered = sorted(results, key=lambda result: result.seed)
    for seed, same in groupby(ordered, key=lambda result: result.seed):
        found = list(same)
        if len(found) > 1:
            raise DatasetError(
                f"There are {len(found)} results of {title_of(found[0])} with training "
                f"seed {seed}. Report one of them."
            )
    for result in ordered:
        if not _same_data(result, ordered[0]):
            raise DatasetError(
                f"{title_of(result)} was trained on other data with seed {result.seed} "
                f"than with seed {ordered[0].seed}, so the seeds cannot be averaged. "
                "Report them separately."
            )
    return tuple(ordered)


def _same_data(one: Result, other: Result) -> bool:
    """Return whether each part of a policy was trained on the same data.

    The digest of data covers the graphics card that rendered the images, and splits
    that no training reads. Newer trainings have recorded one of the rest as well.
    """
    weights, others = one.about["weights"], other.about["weights"]
    if set(weights) != set(others):
        return False
    for name, entry in weights.items():
        data, same = entry.get("data", {}), others[name].get("data", {})
        read = "of_any_renderer"
        keys = [read] if read in data and read in same else ["digest", "renderer"]
        if any(data.get(key) != same.get(key) for key in keys):
            return False
    return True
