"""The tables of the report, made from results alone.

The first row of a policy is strict success; lenient success and the paper's figures are
below it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any

from lemma.core.tables import Table
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.analysis.rates import (
    Cell,
    Rate,
    leniently,
    mean_over_tasks,
    rates_by,
)
from lemma.evaluation.analysis.result import Result
from lemma.evaluation.experiments.catalog import (
    ABLATIONS,
    CONTROL_LEVEL,
    SUITES,
    TEAMS,
    Figures,
    Measured,
)
from lemma.evaluation.protocol.language_controls import FULL, LANGUAGES
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    NOTHING,
    PolicyResults,
    is_plain,
    policy_of,
    shown,
    shown_mean,
    starts_perturbed,
    tasks_of,
)
from lemma.tasks.language.template import ALL_KINDS, EVALUATION_KINDS
from lemma.tasks.names import LADDER, in_order
from lemma.tasks.suite import SUITE

LENIENT = "*lenient*"
PAPER = "*paper*"
_ORDER: Mapping[str, Sequence[Any]] = {"team": TEAMS, "distractors": range(5)}


def words(name: str, gap: str = " ") -> str:
    """Return the name of a kind or cause with another separator of words."""
    return name.replace("_", gap)


@dataclass(frozen=True)
class Column:
    """A column of success rates."""

    name: str
    where: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the cells that it counts, with their values."""
    rate: Callable[[list[list[Cell]]], str] = shown
    sums_up: bool = False
    """Whether it states that a policy without results was not evaluated."""
    has_paper: bool = True
    """Whether the paper's figure may be below it."""

    def paper(self, entry: PolicyResults, kind: str, **where: Any) -> Measured | None:
        """Return the paper's figure for a policy, if there is one."""
        figures = _paper(entry, kind) if self.has_paper else None
        return figures.of(**where) if figures else None


def _lines(
    entry: PolicyResults, columns: Sequence[Column], *label: str, **where: Any
) -> Iterator[tuple[str, ...]]:
    """Yield the rows of a policy: strict, and if available lenient and the paper's.

    Args:
        entry: Results of the policy.
        columns: Columns of rates.
        label: Further texts in the left columns.
        where: Fields of the cells that all columns count, with their values.
    """
    pairs = [(column, {**where, **column.where}) for column in columns]
    cells = (
        column.rate(entry.select(**asked))
        if entry.results or not column.sums_up
        else NOT_RUN
        for column, asked in pairs
    )
    yield (entry.title, *label, *cells)
    later = [(column, entry.select_leniently(**asked)) for column, asked in pairs]
    if any(seeds for _, seeds in later):
        yield (LENIENT, *label, *(column.rate(seeds) for column, seeds in later))
    figures = [column.paper(entry, **asked) for column, asked in pairs]
    if any(figures):
        printed = (NOTHING if one is None else str(one) for one in figures)
        yield (PAPER, *label, *printed)


def _table(
    head: tuple[str, ...], columns: Iterable[Column], rows: Iterable[tuple[str, ...]]
) -> Table:
    names = (column.name for column in columns)
    return Table((*head, *names), tuple(rows), labels=len(head))


def _means(entries: Sequence[PolicyResults]) -> list[Column]:
    """Return a column for every evaluated kind of instructions."""
    kinds = [kind for kind in ALL_KINDS if any(e.has(kind) for e in entries)]
    return [
        Column(words(kind, "-"), {"kind": kind}, shown_mean, sums_up=True)
        for kind in kinds or EVALUATION_KINDS
    ]


def at_a_glance(entries: Sequence[PolicyResults]) -> Table:
    """Return the mean over the tasks of every policy, by kind of instructions."""
    columns = _means(entries)
    rows = (line for entry in entries for line in _lines(entry, columns))
    return _table(("mean over the tasks [%]",), columns, rows)


def ablations(entries: Sequence[PolicyResults]) -> Table:
    """Return the success of ReachNet with one change of its training per row."""
    chosen = [entry for entry in entries if entry.suite == ABLATIONS]
    columns = _means(chosen)
    rows = [
        (*next(_lines(entry, columns)), str(entry.episodes() or NOTHING))
        for entry in chosen
    ]
    return _table(("mean over the tasks [%]",), (*columns, Column("episodes")), rows)


def rates(cells: Sequence[Cell]) -> Table:
    """Return the success of one policy [%], by task (rows) and kind (columns).

    Success is strict, with Wilson intervals; the last row is the mean lenient success.
    """
    every = {kind: [c for c in cells if c.kind == kind] for kind in ALL_KINDS}
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
    # The paper's mean is over all tasks of the suite.
    whole = set(tasks) == set(SUITE)
    mean = Column("mean", {}, shown_mean, sums_up=True, has_paper=whole)
    columns = [*(Column(task, {"task": task}) for task in tasks), mean]
    rows = (line for one in reporting for line in _lines(one, columns, kind=kind))
    return _table(("success [%]",), columns, rows)


def control_level(entries: Iterable[PolicyResults]) -> Table:
    """Return strict success by task of policies at control level."""
    chosen = [
        (entry, entry.experiment)
        for entry in entries
        if entry.experiment and entry.suite == CONTROL_LEVEL
    ]
    played = {task for _, experiment in chosen for task in experiment.tasks}
    tasks = [task for task in LADDER if task in played]
    columns = [Column(task, {"task": task}) for task in tasks]
    # No mean: policies of one rung and of all have no tasks in common to compare by.
    rows = (
        (
            *next(_lines(entry, columns, words(kind, "-"), kind=kind)),
            str(entry.episodes(kind) or NOT_RUN),
        )
        for entry, experiment in chosen
        for kind in experiment.kinds
    )
    head = ("success [%]", "instructions")
    return _table(head, (*columns, Column("episodes")), rows)


def breakdown(entries: Iterable[PolicyResults], kind: str, by: str) -> Table:
    """Return success over all tasks by a field of cells.

    Args:
        entries: Results by policy.
        kind: Kind of instructions.
        by: ``"team"`` or ``"distractors"``.
    """
    reporting = _reporting(entries, kind)
    values = values_of(reporting, kind, by)
    columns = [
        *(Column(str(value), {by: value}) for value in values),
        Column("all", sums_up=True, has_paper=False),
    ]
    rows = (line for one in reporting for line in _lines(one, columns, kind=kind))
    return _table(("success [%]",), columns, rows)


def values_of(entries: Iterable[PolicyResults], kind: str, by: str) -> tuple[Any, ...]:
    """Return the occurring values of a field of cells, first those of the suite.

    Args:
        entries: Results by policy.
        kind: Kind of instructions.
        by: ``"team"`` or ``"distractors"``.
    """
    seeds = (cells for entry in entries for cells in entry.select(kind))
    found = {getattr(cell, by) for cells in seeds for cell in cells}
    known = [value for value in _ORDER[by] if value in found or not found]
    return (*known, *sorted(found.difference(_ORDER[by])))


def distractors_by_task(entries: Iterable[PolicyResults]) -> Table:
    """Return success by task and distractors, with the rows of the paper's table."""
    rows: list[tuple[str, ...]] = []
    columns: list[Column] = []
    for entry in entries:
        for kind in EVALUATION_KINDS:
            figures = _paper(entry, kind)
            for task, reported in figures.distractors.items() if figures else ():
                columns = [
                    Column(str(count), {"distractors": count}, sums_up=True)
                    for count in reported
                ]
                label = task, words(kind, "-")
                rows += _lines(entry, columns, *label, kind=kind, task=task)
    return _table(("success [%]", "task", "instructions"), columns, rows)


def _paper(entry: PolicyResults, kind: str) -> Figures | None:
    return entry.experiment.paper.get(kind) if entry.experiment else None


def _reporting(entries: Iterable[PolicyResults], kind: str) -> list[PolicyResults]:
    """Return the policies with a row in the tables of a kind of instructions.

    Ablations and policies at control level have separate tables. So have results with
    language controls or perturbed starts, if the policy has a result without them.
    """
    apart = (ABLATIONS, CONTROL_LEVEL)
    entries = [entry for entry in entries if entry.suite not in apart]
    results = [result for entry in entries for result in entry.results]
    known = {policy_of(result) for result in results if is_plain(result)}

    def belongs(entry: PolicyResults) -> bool:
        one = entry.experiment
        if not entry.results:
            return one is not None and one.suite in SUITES[:2] and kind in one.kinds
        return entry.has(kind) and any(
            is_plain(result) or policy_of(result) not in known
            for result in entry.results
        )

    return [entry for entry in entries if belongs(entry)]


_CAUSES_HEADER = ("failed", "of", *(words(cause) for cause in Cause))


def losses(entries: Iterable[PolicyResults]) -> Table:
    """Return the causes of failure, by policy and kind of instructions."""
    rows = (
        (entry.title, words(kind, "-"), *_lost(entry, kind))
        for entry in entries
        for kind in ALL_KINDS
        if entry.has(kind)
    )
    return Table(("", "instructions", *_CAUSES_HEADER), tuple(rows), labels=2)


def losses_by_task(entry: PolicyResults) -> Table:
    """Return the causes of failure of one policy, by kind and task with failures."""
    rows = (
        (words(kind, "-"), task, *_lost(entry, kind, task))
        for kind in ALL_KINDS
        for task in tasks_of([entry], kind)
        if entry.causes(kind, task)
    )
    return Table(("instructions", "task", *_CAUSES_HEADER), tuple(rows), labels=2)


def _lost(entry: PolicyResults, kind: str, task: str | None = None) -> tuple[str, ...]:
    counted = entry.causes(kind, task)
    each = (
        NOTHING if cause in entry.untold else str(counted[cause]) for cause in Cause
    )
    return (str(counted.total()), str(entry.episodes(kind, task)), *each)


def cause_shares(entries: Iterable[PolicyResults]) -> Table:
    """Return the share of each cause in all episodes [%], without unused columns."""
    rows = []
    for entry in entries:
        counted, total = entry.causes(), entry.episodes()
        shares = (
            NOTHING if cause in entry.untold else f"{100 * counted[cause] / total:.1f}"
            for cause in Cause
        )
        rows.append((entry.title, f"{100 * counted.total() / total:.1f}", *shares))
    header = ("share of episodes [%]", "failed", *(words(cause) for cause in Cause))
    used = [
        number
        for number in range(len(header))
        if number < 2 or {row[number] for row in rows} - {"0.0", NOTHING}
    ]
    return Table(
        tuple(header[number] for number in used),
        tuple(tuple(row[number] for number in used) for row in rows),
    )


def precision(entries: Sequence[PolicyResults], kind: str) -> Table:
    """Return the errors of poses [mm] and the share of misses, by task."""
    tasks = tasks_of(entries, kind)
    rows = []
    for entry in entries:
        for end in ("pick", "place"):
            cells = [_precision(entry, kind, task, end) for task in tasks]
            if any(cell != NOTHING for cell in cells):
                rows.append((entry.title, end, *cells))
    return Table(("median error [mm] (missed)", "end", *tasks), tuple(rows), labels=2)


def _precision(entry: PolicyResults, kind: str, task: str, end: str) -> str:
    """Return the mean over seeds of the median error [mm], and the share of misses."""
    found = [
        one
        for result in entry.results
        for one in result.precisions
        if (one.kind, one.task, one.end) == (kind, task, end)
    ]
    if not found:
        return NOTHING
    missed = sum(one.missed for one in found) / sum(one.poses for one in found)
    return f"{fmean(one.median_mm for one in found):.1f} ({100 * missed:.1f} %)"


def language(entries: Iterable[PolicyResults]) -> Table:
    """Return the success of each policy with language controls, if there are any.

    Success is always for the goal of the instance. For the control without a sentence,
    scenes without distractors have a separate column, because few goals are possible in
    them. The last column is how often the other goal of swapped colors holds, among the
    scenes in which it is possible.
    """
    rows = []
    for family in _families(entries, lambda result: not starts_perturbed(result)):
        by_language = {name: _where(family, language=name) for name in LANGUAGES}
        for kind in ALL_KINDS:
            each = [shown_mean(by_language[name].select(kind)) for name in LANGUAGES]
            if any(cell != NOTHING for cell in each[1:]):
                guesses = by_language["none"].select(kind)
                bare, others = (
                    shown(
                        [[c for c in g if (c.distractors == 0) is b] for g in guesses]
                    )
                    for b in (True, False)
                )
                held = _asked(by_language["swapped"], kind)
                rows.append((family.title, words(kind, "-"), *each, bare, others, held))
    last = ("none, no distractors", "none, others", "swapped goal")
    header = ("mean over the tasks [%]", "instructions", *LANGUAGES, *last)
    return Table(header, tuple(rows), labels=2)


def starts(entries: Iterable[PolicyResults]) -> Table:
    """Return success from perturbed starts and from the instances' own starts."""
    rows = []
    for family in _families(entries, lambda result: result.about["language"] == FULL):
        own = _where(family, perturb_start=False)
        moved = _where(family, perturb_start=True)
        for kind in ALL_KINDS:
            both = shown_mean(own.select(kind)), shown_mean(moved.select(kind))
            if both[1] != NOTHING:
                rows.append((family.title, words(kind, "-"), *both))
    header = ("mean over the tasks [%]", "instructions", "own start", "perturbed start")
    return Table(header, tuple(rows), labels=2)


def _families(
    entries: Iterable[PolicyResults], wanted: Callable[[Result], bool]
) -> list[PolicyResults]:
    """Return selected results of each policy, across language controls and starts."""
    titles: dict[str, str] = {}
    found: dict[str, list[Result]] = {}
    for entry in entries:
        for result in () if entry.suite == ABLATIONS else entry.results:
            name = policy_of(result)
            if is_plain(result) or name not in titles:
                titles[name] = entry.title
            if wanted(result):
                found.setdefault(name, []).append(result)
    return [PolicyResults(titles[name], tuple(found[name])) for name in found]


def _where(family: PolicyResults, **about: object) -> PolicyResults:
    """Return the results of a policy with some settings."""
    kept = (
        result
        for result in family.results
        if all(result.about.get(name, False) == value for name, value in about.items())
    )
    return PolicyResults(family.title, tuple(kept))


def _asked(family: PolicyResults, kind: str) -> str:
    """Return how often the control's other goal holds [%], and of how many episodes."""
    every = (one for result in family.results for one in result.asked)
    listed = [one for one in every if one.kind == kind]
    episodes = sum(one.episodes for one in listed)
    if not episodes:
        return NOTHING
    return f"{100 * sum(one.held for one in listed) / episodes:.1f} of {episodes}"
