"""The tables: rows and columns made from results, and from nothing else."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from lemma.evaluation.analysis.coordination import Coordination
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.analysis.result import Result
from lemma.evaluation.report.policy_results import (
    NOTHING,
    PolicyResults,
    is_ablation,
    is_plain,
    mean_cell,
    policy_of,
    pooled,
    shown,
    shown_mean,
    starts_perturbed,
    tasks_of,
)
from lemma.evaluation.run.language_controls import FULL, LANGUAGES
from lemma.tasks.language.template import EVALUATION_KINDS


@dataclass(frozen=True)
class ResultTable:
    """A table, ready to be written in any form."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    labels: int = 1
    """Columns from the left that hold words, not numbers."""


def markdown(table: ResultTable) -> str:
    """Return a table in Markdown, numbers to the right."""
    numbers = len(table.header) - table.labels
    rule = [*[":---"] * table.labels, *["---:"] * numbers]
    lines = (table.header, rule, *table.rows)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def words(name: str, gap: str = " ") -> str:
    """Return the name of a kind or cause as people write it."""
    return name.replace("_", gap)


def ablations(entries: Sequence[PolicyResults]) -> ResultTable:
    """Return the success of ReachNet with one thing of its training changed each."""
    chosen = [entry for entry in entries if is_ablation(entry)]
    kinds = [
        kind for kind in EVALUATION_KINDS if any(entry.has(kind) for entry in chosen)
    ]
    rows = [
        (
            entry.title,
            *(mean_cell(entry, kind) for kind in kinds),
            str(sum(_episodes(entry, kind) for kind in kinds) or NOTHING),
        )
        for entry in chosen
    ]
    header = ("mean over the tasks [%]", *(words(k, "-") for k in kinds), "episodes")
    return ResultTable(header, tuple(rows))


def losses(entries: Iterable[PolicyResults]) -> ResultTable:
    """Return why episodes failed, by policy and kind of instructions."""
    rows = []
    for entry in entries:
        for kind in EVALUATION_KINDS:
            if entry.has(kind):
                counted = _causes(entry, kind)
                episodes = _episodes(entry, kind)
                rows.append(
                    (entry.title, words(kind, "-"), *_counts(counted, episodes))
                )
    return ResultTable(("", "instructions", *_CAUSES_HEADER), tuple(rows), labels=2)


def losses_by_task(entry: PolicyResults) -> ResultTable:
    """Return why episodes of one policy failed, by kind and task; where any did."""
    rows = []
    for kind in EVALUATION_KINDS:
        for task in tasks_of([entry], kind):
            counted = _causes(entry, kind, task)
            if counted:
                episodes = _episodes(entry, kind, task=task)
                rows.append((words(kind, "-"), task, *_counts(counted, episodes)))
    return ResultTable(("instructions", "task", *_CAUSES_HEADER), tuple(rows), labels=2)


def precision(entries: Sequence[PolicyResults], kind: str) -> ResultTable:
    """Return how far off poses are [mm], and how many are missed, by task."""
    tasks = tasks_of(entries, kind)
    rows = []
    for entry in entries:
        for end in ("pick", "place"):
            cells = [_precision(entry, kind, task, end) for task in tasks]
            if any(cell != NOTHING for cell in cells):
                rows.append((entry.title, end, *cells))
    return ResultTable(
        ("median error [mm] (missed)", "end", *tasks), tuple(rows), labels=2
    )


def coordination(entries: Iterable[PolicyResults], kind: str) -> ResultTable:
    """Return how well robots work together, over all tasks.

    What is counted is defined in :mod:`lemma.evaluation.analysis.coordination`.
    """
    rows = []
    for entry in entries:
        seeds = [
            found
            for result in entry.results
            for found in [[one for one in result.coordination if one.kind == kind]]
            if found
        ]
        if seeds and not is_ablation(entry):
            rows.append((entry.title, *_coordination(seeds)))
    header = (
        "time / expert's",
        "idle, left [%]",
        "idle, right [%]",
        "first-try allocation [%]",
        "expert's robot [%]",
        "order violations per 100",
        "nearest arms [mm]",
        "touching",
        "protective stops per 100",
        "lenient: refusals per 100",
        "lenient: time / expert's",
    )
    return ResultTable(("", *header), tuple(rows))


def language(entries: Iterable[PolicyResults]) -> ResultTable:
    """Return how much each policy needs the sentence, where a control was run.

    The success is at the goal of the instance, whatever is said. Where nothing is said,
    tables without distractors stand apart, because they leave little to guess. The last
    column is how often the other goal holds that swapped colors ask for, where the
    table allows it.
    """
    families = _families(entries, lambda result: not starts_perturbed(result))
    rows = []
    for title, results in families.items():
        by_control = {told: _by_language(results, told) for told in LANGUAGES}
        for kind in EVALUATION_KINDS:
            each = [_mean_of(by_control[told], kind) for told in LANGUAGES]
            if any(cell != NOTHING for cell in each[1:]):
                guessed = (
                    _mean_of_tables(by_control["none"], kind, bare=bare)
                    for bare in (True, False)
                )
                held = _asked(by_control["swapped"], kind)
                rows.append((title, words(kind, "-"), *each, *guessed, held))
    header = (
        "mean over the tasks [%]",
        "instructions",
        *LANGUAGES,
        "none, no distractors",
        "none, others",
        "swapped goal",
    )
    return ResultTable(header, tuple(rows), labels=2)


def starts(entries: Iterable[PolicyResults]) -> ResultTable:
    """Return success from perturbed starts beside that from the instances' own."""
    families = _families(entries, lambda result: result.about["language"] == FULL)
    rows = []
    for title, results in families.items():
        own = [one for one in results if not starts_perturbed(one)]
        moved = [one for one in results if starts_perturbed(one)]
        for kind in EVALUATION_KINDS:
            both = _mean_of(own, kind), _mean_of(moved, kind)
            if both[1] != NOTHING:
                rows.append((title, words(kind, "-"), *both))
    header = ("mean over the tasks [%]", "instructions", "own start", "perturbed start")
    return ResultTable(header, tuple(rows), labels=2)


_CAUSES_HEADER = ("failed", "of", *(words(cause) for cause in Cause))


def _causes(entry: PolicyResults, kind: str, task: str | None = None) -> Counter[str]:
    counted: Counter[str] = Counter()
    for result in entry.results:
        for loss in result.losses:
            if loss.kind == kind and task in (None, loss.task):
                counted[loss.cause] += loss.episodes
    return counted


def _episodes(entry: PolicyResults, kind: str, **where: object) -> int:
    return sum(c.episodes for cells in entry.select(kind, **where) for c in cells)


def _counts(counted: Counter[str], episodes: int) -> tuple[str, ...]:
    each = (str(counted[cause]) if counted[cause] else NOTHING for cause in Cause)
    return (str(counted.total()), str(episodes), *each)


def _precision(entry: PolicyResults, kind: str, task: str, end: str) -> str:
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


def _coordination(seeds: Sequence[Sequence[Coordination]]) -> tuple[str, ...]:
    """Return the cells of a row: means over the seeds, extremes of all."""

    def ratio(part: str, whole: str, scale: float = 100.0) -> str:
        values = [
            scale * sum(getattr(one, part) for one in found) / below
            for found in seeds
            if (below := sum(getattr(one, whole) for one in found))
        ]
        return _spread(values, 2 if scale == 1.0 else 1)

    def idle(robot: str) -> str:
        values = [
            100.0
            * sum(one.idle_s.get(robot, 0.0) for one in found)
            / sum(one.elapsed_s for one in found)
            for found in seeds
        ]
        return _spread(values, 1)

    every = [one for found in seeds for one in found]
    played_strictly = any(one.refusals is None for one in every)
    gaps = [one.nearest_mm for one in every if one.nearest_mm is not None]
    return (
        ratio("timed_s", "expert_s", 1.0),
        idle("robot_0"),
        idle("robot_1"),
        ratio("able", "doable"),
        ratio("as_expert", "planned"),
        ratio("order_violations", "episodes"),
        f"{min(gaps):.0f}" if gaps else NOTHING,
        str(sum(one.touching for one in every)),
        ratio("stops", "episodes"),
        NOTHING if played_strictly else ratio("refusals", "episodes"),
        ratio("lenient_timed_s", "lenient_expert_s", 1.0),
    )


def _spread(values: Sequence[float], places: int) -> str:
    """Return a mean, with the standard deviation over seeds if there are several."""
    if not values:
        return NOTHING
    mean = f"{fmean(values):.{places}f}"
    return f"{mean} ± {stdev(values):.{places}f}" if len(values) > 1 else mean


def _families(
    entries: Iterable[PolicyResults], wanted: Callable[[Result], bool]
) -> dict[str, list[Result]]:
    """Return some results of each policy, whatever was said and wherever it began."""
    titles: dict[str, str] = {}
    found: dict[str, list[Result]] = {}
    for entry in entries:
        for result in () if is_ablation(entry) else entry.results:
            name = policy_of(result)
            if is_plain(result) or name not in titles:
                titles[name] = entry.title
            if wanted(result):
                found.setdefault(name, []).append(result)
    return {titles[name]: results for name, results in found.items()}


def _by_language(results: Iterable[Result], told: str) -> list[Result]:
    return [result for result in results if result.about["language"] == told]


def _mean_of(results: Iterable[Result], kind: str) -> str:
    seeds = [[cell for cell in one.cells if cell.kind == kind] for one in results]
    return shown_mean(seeds)


def _mean_of_tables(results: Iterable[Result], kind: str, *, bare: bool) -> str:
    """Return success [%] on tables without distractors, or on the others."""
    seeds = [
        [c for c in one.cells if c.kind == kind and (c.distractors == 0) is bare]
        for one in results
    ]
    return shown(seeds, pooled)


def _asked(results: Iterable[Result], kind: str) -> str:
    """Return how often another goal holds that was asked for [%], of how many."""
    listed = [one for result in results for one in result.asked if one.kind == kind]
    episodes = sum(one.episodes for one in listed)
    if not episodes:
        return NOTHING
    return f"{100 * sum(one.held for one in listed) / episodes:.1f} of {episodes}"
