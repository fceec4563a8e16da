"""The tables of success: strict as the headline, lenient and the paper's below it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from lemma.core.tables import Table
from lemma.evaluation.analysis.intervals import (
    Rate,
    leniently,
    mean_over_tasks,
    rates_by,
)
from lemma.evaluation.analysis.result import Cell
from lemma.evaluation.experiments.catalog import SUITES
from lemma.evaluation.experiments.paper_figures import TEAMS, Figures, Measured
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    NOTHING,
    PolicyResults,
    is_ablation,
    is_control_level,
    is_plain,
    mean_cell,
    policy_of,
    pooled,
    shown,
    shown_mean,
    tasks_of,
)
from lemma.evaluation.report.tables import words
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.names import in_order
from lemma.tasks.suite import SUITE

LENIENT = "*lenient*"
PAPER = "*paper*"
_DISTRACTORS = range(5)


def at_a_glance(entries: Sequence[PolicyResults]) -> Table:
    """Return the mean over the tasks of every policy, by kind of instructions."""
    kinds = [
        kind for kind in EVALUATION_KINDS if any(entry.has(kind) for entry in entries)
    ]
    kinds = kinds or list(EVALUATION_KINDS)
    rows: list[tuple[str, ...]] = []
    for entry in entries:
        rows.append((entry.title, *(mean_cell(entry, kind) for kind in kinds)))
        each = [entry.select_leniently(kind) for kind in kinds]
        if any(each):
            rows.append((LENIENT, *map(shown_mean, each)))
        paper = [_paper(entry, kind) for kind in kinds]
        if any(paper):
            means = (figures.mean if figures else None for figures in paper)
            rows.append((PAPER, *map(_printed, means)))
    header = ("mean over the tasks [%]", *(words(kind, "-") for kind in kinds))
    return Table(header, tuple(rows))


def rates(cells: Sequence[Cell]) -> Table:
    """Return the success of one policy [%]: tasks down, kinds of instructions across.

    Strict, with Wilson intervals; the last row is the mean of the lenient verdict.
    """
    every = {kind: [c for c in cells if c.kind == kind] for kind in EVALUATION_KINDS}
    columns = {kind: listed for kind, listed in every.items() if listed}
    by_name = [rates_by(column, "task") for column in columns.values()]
    tasks = in_order(cell.task for cell in cells)
    rows = [
        (task, *(_interval(found.get((task,))) for found in by_name)) for task in tasks
    ]
    many = f"{len(tasks)} task{'s' * (len(tasks) > 1)}"
    over = "mean" if set(tasks) == set(SUITE) else f"mean of {many}"
    later = [leniently(column) for column in columns.values()]
    for title, listed in ((over, list(columns.values())), ("mean, lenient", later)):
        if all(listed):
            means = (f"{100 * mean_over_tasks(column):.1f}" for column in listed)
            rows.append((title, *means))
    return Table(("success [%]", *(words(k, "-") for k in columns)), tuple(rows))


def _interval(rate: Rate | None) -> str:
    if rate is None:
        return ""
    low, high = rate.interval
    return f"{100 * rate.success_rate:.1f} ({100 * low:.0f}-{100 * high:.0f})"


def by_task(entries: Iterable[PolicyResults], kind: str) -> Table:
    """Return success by task with one kind of instructions."""
    reporting = _reporting(entries, kind)
    tasks = tasks_of(reporting, kind)
    rows: list[tuple[str, ...]] = []
    for entry in reporting:
        strict = [entry.select(kind, task=task) for task in tasks]
        rows.append((entry.title, *map(_pooled, strict), mean_cell(entry, kind)))
        whole = entry.select_leniently(kind)
        if whole:
            later = [entry.select_leniently(kind, task=task) for task in tasks]
            rows.append((LENIENT, *map(_pooled, later), shown_mean(whole)))
        figures = _paper(entry, kind)
        if figures is not None:
            each = (_printed(figures.tasks.get(task)) for task in tasks)
            # The paper's mean is over all of them.
            mean = _printed(figures.mean if set(tasks) == set(SUITE) else None)
            rows.append((PAPER, *each, mean))
    return Table(("success [%]", *tasks, "mean"), tuple(rows))


def control_level(entries: Iterable[PolicyResults]) -> Table:
    """Return success by task of what answers motor commands, strict."""
    entries = [entry for entry in entries if is_control_level(entry)]
    asked = [one.experiment.tasks for one in entries if one.experiment]
    tasks = in_order(task for tasks in asked for task in tasks)
    rows: list[tuple[str, ...]] = []
    for entry in entries:
        kinds = entry.experiment.kinds if entry.experiment else ()
        for kind in kinds:
            each = (_pooled(entry.select(kind, task=task)) for task in tasks)
            label = (entry.title, words(kind, "-"))
            rows.append((*label, *each, mean_cell(entry, kind)))
    header = ("success [%]", "instructions", *tasks, "mean")
    return Table(header, tuple(rows), labels=2)


def by_distractors(entries: Iterable[PolicyResults], kind: str) -> Table:
    """Return success by number of distractors, over all tasks."""
    return _breakdown(entries, kind, "distractors")


def by_team(entries: Iterable[PolicyResults], kind: str) -> Table:
    """Return success by types of the robots, over all tasks."""
    return _breakdown(entries, kind, "team")


def distractors_by_task(entries: Iterable[PolicyResults]) -> Table:
    """Return success by task and distractors where the paper has it: its own table."""
    rows: list[tuple[str, ...]] = []
    columns: tuple[int, ...] = ()
    for entry in entries:
        for kind in EVALUATION_KINDS:
            figures = _paper(entry, kind)
            for task, reported in figures.distractors.items() if figures else ():
                columns = tuple(reported)
                rows += _by_number(entry, kind, task, reported)
    header = ("success [%]", "task", "instructions", *map(str, columns))
    return Table(header, tuple(rows), labels=3)


def _by_number(
    entry: PolicyResults, kind: str, task: str, reported: Mapping[int, Measured]
) -> list[tuple[str, ...]]:
    wanted = [{"task": task, "distractors": count} for count in reported]
    label = (task, words(kind, "-"))
    strict = [entry.select(kind, **where) for where in wanted]
    cells = [_pooled(each) if entry.results else NOT_RUN for each in strict]
    rows = [(entry.title, *label, *cells)]
    later = [entry.select_leniently(kind, **where) for where in wanted]
    if any(later):
        rows.append((LENIENT, *label, *map(_pooled, later)))
    return [*rows, (PAPER, *label, *map(_printed, reported.values()))]


def values_of(
    entries: Iterable[PolicyResults], kind: str, field: str
) -> tuple[Any, ...]:
    """Return the values of a field of cells that occur, those of the suite first.

    Args:
        entries: Where.
        kind: Kind of instructions.
        field: ``"team"`` or ``"distractors"``.
    """
    order: Sequence[Any] = {"team": TEAMS, "distractors": _DISTRACTORS}[field]
    seeds = (cells for entry in entries for cells in entry.select(kind))
    found = {getattr(cell, field) for cells in seeds for cell in cells}
    known = [value for value in order if value in found or not found]
    return (*known, *sorted(found.difference(order)))


def _breakdown(entries: Iterable[PolicyResults], kind: str, field: str) -> Table:
    reporting = _reporting(entries, kind)
    values = values_of(reporting, kind, field)
    rows: list[tuple[str, ...]] = []
    for entry in reporting:
        wanted = [{field: value} for value in values] + [{}]
        strict = [_pooled(entry.select(kind, **where)) for where in wanted]
        if not entry.results:
            strict[-1] = NOT_RUN
        rows.append((entry.title, *strict))
        later = [entry.select_leniently(kind, **where) for where in wanted]
        if any(later):
            rows.append((LENIENT, *map(_pooled, later)))
        figures = _paper(entry, kind)
        reported = figures.teams if figures and field == "team" else {}
        if reported:
            rows.append((PAPER, *(_printed(reported.get(v)) for v in values), NOTHING))
    return Table(("success [%]", *map(str, values), "all"), tuple(rows))


def _pooled(seeds: list[list[Cell]]) -> str:
    return shown(seeds, pooled)


def _paper(entry: PolicyResults, kind: str) -> Figures | None:
    return entry.experiment.paper.get(kind) if entry.experiment else None


def _printed(figure: Measured | None) -> str:
    return NOTHING if figure is None else str(figure)


def _reporting(entries: Iterable[PolicyResults], kind: str) -> list[PolicyResults]:
    """Return those that are rows of a table of a kind.

    Not the ablations and what acts at control level, nor a policy that was told other
    sentences or began elsewhere, if it stands there without: tables of their own
    compare the two.
    """
    entries = [
        entry
        for entry in entries
        if not (is_ablation(entry) or is_control_level(entry))
    ]
    results = [result for entry in entries for result in entry.results]
    known = {policy_of(result) for result in results if is_plain(result)}

    def stands_elsewhere(entry: PolicyResults) -> bool:
        return bool(entry.results) and all(
            not is_plain(result) and policy_of(result) in known
            for result in entry.results
        )

    return [
        entry
        for entry in entries
        if not stands_elsewhere(entry)
        and (entry.has(kind) if entry.results else _is_asked(entry, kind))
    ]


def _is_asked(entry: PolicyResults, kind: str) -> bool:
    """Whether a policy without results belongs into a table all the same."""
    one = entry.experiment
    return one is not None and one.suite in SUITES[:2] and kind in one.kinds
