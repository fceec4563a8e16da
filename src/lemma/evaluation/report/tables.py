"""The tables: rows and columns made from results, and from nothing else."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from lemma.core.tables import Table
from lemma.evaluation.analysis.coordination import Coordination
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.analysis.result import Result
from lemma.evaluation.protocol.language_controls import FULL, LANGUAGES
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
from lemma.tasks.language.template import EVALUATION_KINDS


def words(name: str, gap: str = " ") -> str:
    """Return the name of a kind or cause as people write it."""
    return name.replace("_", gap)


def ablations(entries: Sequence[PolicyResults]) -> Table:
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
    return Table(header, tuple(rows))


def losses(entries: Iterable[PolicyResults]) -> Table:
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
    return Table(("", "instructions", *_CAUSES_HEADER), tuple(rows), labels=2)


def losses_by_task(entry: PolicyResults) -> Table:
    """Return why episodes of one policy failed, by kind and task; where any did."""
    rows = []
    for kind in EVALUATION_KINDS:
        for task in tasks_of([entry], kind):
            counted = _causes(entry, kind, task)
            if counted:
                episodes = _episodes(entry, kind, task=task)
                rows.append((words(kind, "-"), task, *_counts(counted, episodes)))
    return Table(("instructions", "task", *_CAUSES_HEADER), tuple(rows), labels=2)


def precision(entries: Sequence[PolicyResults], kind: str) -> Table:
    """Return how far off poses are [mm], and how many are missed, by task."""
    tasks = tasks_of(entries, kind)
    rows = []
    for entry in entries:
        for end in ("pick", "place"):
            cells = [_precision(entry, kind, task, end) for task in tasks]
            if any(cell != NOTHING for cell in cells):
                rows.append((entry.title, end, *cells))
    return Table(("median error [mm] (missed)", "end", *tasks), tuple(rows), labels=2)


@dataclass(frozen=True)
class Metric:
    """A column of numbers."""

    name: str
    of_seed: Callable[[Sequence[Coordination]], float | None]
    """Its value with one training seed; None where it is not defined."""
    places: int = 1
    """Digits behind the point."""
    over_seeds: Callable[[Sequence[float]], float] | None = None
    """How seeds are joined; mean and standard deviation if None."""

    def shown(self, seeds: Sequence[Sequence[Coordination]]) -> str:
        """Return the cell of a table."""
        each = [self.of_seed(found) for found in seeds]
        values = [value for value in each if value is not None]
        if not values:
            return NOTHING
        if self.over_seeds is not None:
            return f"{self.over_seeds(values):.{self.places}f}"
        mean = f"{fmean(values):.{self.places}f}"
        if len(values) == 1:
            return mean
        return f"{mean} ± {stdev(values):.{self.places}f}"


Sum = Callable[[Coordination], float]


def _ratio(
    part: Sum, whole: Sum, scale: float = 100.0
) -> Callable[[Sequence[Coordination]], float | None]:
    """Return a ratio of two sums, which is not defined where the second is 0."""

    def of_seed(found: Sequence[Coordination]) -> float | None:
        below = sum(map(whole, found))
        return scale * sum(map(part, found)) / below if below else None

    return of_seed


def _refusals(found: Sequence[Coordination]) -> float | None:
    counts = [one.refusals for one in found]
    episodes = sum(one.episodes for one in found)
    played = [count for count in counts if count is not None]
    return 100.0 * sum(played) / episodes if len(played) == len(counts) else None


def _nearest(found: Sequence[Coordination]) -> float | None:
    gaps = (one.nearest_mm for one in found)
    return min((gap for gap in gaps if gap is not None), default=None)


def _idle(robot: str, name: str) -> Metric:
    return Metric(
        f"idle, {name} [%]",
        _ratio(lambda one: one.idle_s.get(robot, 0.0), lambda one: one.elapsed_s),
    )


COORDINATION = (
    Metric(
        "time / expert's", _ratio(lambda c: c.timed_s, lambda c: c.expert_s, 1.0), 2
    ),
    _idle("robot_0", "left"),
    _idle("robot_1", "right"),
    Metric("first-try allocation [%]", _ratio(lambda c: c.able, lambda c: c.doable)),
    Metric("expert's robot [%]", _ratio(lambda c: c.as_expert, lambda c: c.planned)),
    Metric(
        "order violations per 100",
        _ratio(lambda c: c.order_violations, lambda c: c.episodes),
    ),
    Metric("nearest arms [mm]", _nearest, 0, min),
    Metric("touching", lambda found: sum(one.touching for one in found), 0, sum),
    Metric("protective stops per 100", _ratio(lambda c: c.stops, lambda c: c.episodes)),
    Metric("lenient: refusals per 100", _refusals),
    Metric(
        "lenient: time / expert's",
        _ratio(lambda c: c.lenient_timed_s, lambda c: c.lenient_expert_s, 1.0),
        2,
    ),
)
"""Columns of the table of how robots work together."""


def coordination(entries: Iterable[PolicyResults], kind: str) -> Table:
    """Return how well robots work together, over all tasks.

    The measures are defined in :mod:`lemma.evaluation.analysis.coordination`.
    """
    rows = []
    for entry in entries:
        each = (
            [one for one in result.coordination if one.kind == kind]
            for result in entry.results
        )
        seeds = [found for found in each if found]
        if seeds and not is_ablation(entry):
            rows.append((entry.title, *(one.shown(seeds) for one in COORDINATION)))
    return Table(("", *(one.name for one in COORDINATION)), tuple(rows))


def language(entries: Iterable[PolicyResults]) -> Table:
    """Return how much each policy needs the sentence, where a control was run.

    Success is at the goal of the instance, for every sentence. Without a sentence,
    tables without distractors have their own column: they leave little to guess. The
    last column is how often the other goal of swapped colors holds, where the table
    allows that goal.
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
    return Table(header, tuple(rows), labels=2)


def starts(entries: Iterable[PolicyResults]) -> Table:
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
    return Table(header, tuple(rows), labels=2)


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


def _families(
    entries: Iterable[PolicyResults], wanted: Callable[[Result], bool]
) -> dict[str, list[Result]]:
    """Return some results of each policy, across sentences and starts."""
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
