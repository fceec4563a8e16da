"""The tables: rows and columns made from results, and from nothing else."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from lemma.evaluation.diagnosis import Cause
from lemma.evaluation.entries import NOTHING, Entry, mean_of, pooled, shown
from lemma.evaluation.experiments import ABLATION_BASE, ABLATIONS, SUITES
from lemma.evaluation.summary import mean_over_tasks
from lemma.tasks.suite import SUITE
from lemma.tasks.template import KINDS

NOT_RUN = "not run"
TEAMS = ("ur5+ur5", "ur5+ur10", "ur10+ur10")
DISTRACTORS = (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class Table:
    """A table, ready to be written in any form."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    labels: int = 1
    """Columns from the left that hold words, not numbers."""


def markdown(table: Table) -> str:
    """Return a table in Markdown, numbers to the right."""
    numbers = len(table.header) - table.labels
    rule = [*[":---"] * table.labels, *["---:"] * numbers]
    lines = (table.header, rule, *table.rows)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def words(name: str, gap: str = " ") -> str:
    """Return the name of a kind or cause as people write it."""
    return name.replace("_", gap)


def targets(entries: Iterable[Entry]) -> Table:
    """Return what each policy should reach, and whether it does."""
    rows = []
    for entry in entries:
        experiment = entry.experiment
        for kind in experiment.targets if experiment else ():
            assert experiment is not None
            least, mean = experiment.targets[kind], mean_of(entry, kind)
            if mean is None and entry.results:
                continue
            verdict = NOT_RUN if mean is None else "yes" if mean >= least else "**no**"
            rows.append(
                (
                    entry.title,
                    words(kind, "-"),
                    _paper_mean(entry, kind),
                    f"{least:.0f}",
                    _mean(entry, kind),
                    verdict,
                )
            )
    header = ("mean over the tasks [%]", "instructions", "paper", "at least", "here")
    return Table((*header, "reached"), tuple(rows), labels=2)


def by_task(entries: Iterable[Entry], kind: str) -> Table:
    """Return success by task with one kind of instructions; paper's figures below."""
    rows = []
    for entry in _reporting(entries, kind):
        each = [shown(entry.select(kind, task=task), pooled) for task in SUITE]
        rows.append((entry.title, *each, _mean(entry, kind)))
        rows += _paper_rows(entry, kind)
    return Table(("success [%]", *SUITE, "mean"), tuple(rows))


def by_distractors(entries: Iterable[Entry], kind: str) -> Table:
    """Return success by number of distractors, over all tasks."""
    counts = [str(count) for count in DISTRACTORS]
    columns = [{"distractors": count} for count in DISTRACTORS]
    return _breakdown(entries, kind, counts, columns)


def by_team(entries: Iterable[Entry], kind: str) -> Table:
    """Return success by types of the robots, over all tasks."""
    return _breakdown(entries, kind, TEAMS, [{"team": team} for team in TEAMS])


def ablations(entries: Sequence[Entry]) -> Table:
    """Return the success of ReachNet with one thing of its training changed each."""
    rows = [
        (
            "ReachNet as it ships" if _is_base(entry) else entry.title,
            *(_mean(entry, kind) for kind in KINDS),
        )
        for wanted in (_is_base, _is_ablation)
        for entry in entries
        if wanted(entry)
    ]
    header = ("mean over the tasks [%]", *(words(kind, "-") for kind in KINDS))
    return Table(header, tuple(rows))


def losses(entries: Iterable[Entry]) -> Table:
    """Return why episodes failed, by policy and kind of instructions."""
    rows = []
    for entry in entries:
        for kind in KINDS:
            if entry.has(kind):
                counted = _causes(entry, kind)
                episodes = _episodes(entry, kind)
                rows.append(
                    (entry.title, words(kind, "-"), *_counts(counted, episodes))
                )
    return Table(("", "instructions", *_CAUSES_HEADER), tuple(rows), labels=2)


def losses_by_task(entry: Entry) -> Table:
    """Return why episodes of one policy failed, by kind and task; where any did."""
    rows = []
    for kind in KINDS:
        for task in SUITE:
            counted = _causes(entry, kind, task)
            if counted:
                episodes = _episodes(entry, kind, task=task)
                rows.append((words(kind, "-"), task, *_counts(counted, episodes)))
    return Table(("instructions", "task", *_CAUSES_HEADER), tuple(rows), labels=2)


def precision(entries: Iterable[Entry], kind: str) -> Table:
    """Return how far off poses are [mm], and how many are missed, by task."""
    rows = []
    for entry in entries:
        for end in ("pick", "place"):
            cells = [_precision(entry, kind, task, end) for task in SUITE]
            if any(cell != NOTHING for cell in cells):
                rows.append((entry.title, end, *cells))
    return Table(("median error [mm] (missed)", "end", *SUITE), tuple(rows), labels=2)


_CAUSES_HEADER = ("failed", "of", *(words(cause) for cause in Cause))


def _causes(entry: Entry, kind: str, task: str | None = None) -> Counter[str]:
    counted: Counter[str] = Counter()
    for result in entry.results:
        for loss in result.losses:
            if loss.kind == kind and task in (None, loss.task):
                counted[loss.cause] += loss.episodes
    return counted


def _episodes(entry: Entry, kind: str, **where: object) -> int:
    return sum(c.episodes for cells in entry.select(kind, **where) for c in cells)


def _counts(counted: Counter[str], episodes: int) -> tuple[str, ...]:
    each = (str(counted[cause]) if counted[cause] else NOTHING for cause in Cause)
    return (str(counted.total()), str(episodes), *each)


def _precision(entry: Entry, kind: str, task: str, end: str) -> str:
    """Return the median error [mm], mean over seeds, and the part that is missed."""
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


def _breakdown(
    entries: Iterable[Entry],
    kind: str,
    names: Sequence[str],
    columns: Sequence[Mapping[str, object]],
) -> Table:
    rows = [
        (
            entry.title,
            *(shown(entry.select(kind, **where), pooled) for where in columns),
            shown(entry.select(kind), pooled) if entry.results else NOT_RUN,
        )
        for entry in _reporting(entries, kind)
    ]
    return Table(("success [%]", *names, "all"), tuple(rows))


def _reporting(entries: Iterable[Entry], kind: str) -> list[Entry]:
    """Return those that are rows of a table of a kind: not the ablations."""
    return [
        entry
        for entry in entries
        if not _is_ablation(entry)
        and (entry.has(kind) if entry.results else _is_asked(entry, kind))
    ]


def _is_asked(entry: Entry, kind: str) -> bool:
    """Whether a policy without results belongs into a table all the same."""
    one = entry.experiment
    return one is not None and one.suite in SUITES[:2] and kind in one.kinds


def _is_ablation(entry: Entry) -> bool:
    return entry.experiment is not None and entry.experiment.suite == ABLATIONS


def _is_base(entry: Entry) -> bool:
    return entry.experiment is not None and entry.experiment.name == ABLATION_BASE


def _mean(entry: Entry, kind: str) -> str:
    return shown(entry.select(kind), mean_over_tasks) if entry.results else NOT_RUN


def _paper_mean(entry: Entry, kind: str) -> str:
    figures = entry.experiment.paper.get(kind) if entry.experiment else None
    return NOTHING if figures is None or figures.mean is None else f"{figures.mean:.1f}"


def _paper_rows(entry: Entry, kind: str) -> list[tuple[str, ...]]:
    figures = entry.experiment.paper.get(kind) if entry.experiment else None
    if figures is None:
        return []
    each = (f"≈ {figures.tasks[t]}" if t in figures.tasks else NOTHING for t in SUITE)
    return [("*paper*", *each, _paper_mean(entry, kind))]
