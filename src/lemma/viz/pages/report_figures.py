"""The figures of a report."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from statistics import fmean, stdev

from lemma.core.files import write_text
from lemma.env.stages import Stage
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.analysis.rates import Cell, mean_over_tasks, rate_of
from lemma.evaluation.experiments.catalog import ABLATIONS, CONTROL_LEVEL, Measured
from lemma.evaluation.report.policy_results import PolicyResults, tasks_of
from lemma.evaluation.report.tables import values_of, words
from lemma.tasks.language.template import ALL_KINDS, EVALUATION_KINDS
from lemma.tasks.suite import SUITE
from lemma.viz.plots import Bar, Figure, Mark, Series, dots, lines, stacks, standalone

FIGURES = "figures"
_NOT_PLOTTED = (ABLATIONS, CONTROL_LEVEL, "controls")
_NONE, _FIRST, _LATER = "none", "first:", "later:"
_STAGES = (
    _NONE,
    *(
        f"{which} {stage}"
        for which in (_FIRST, _LATER)
        for stage in Stage
        if stage is not Stage.DRAGGED
    ),
)
"""Parts of a bar; dragging with the stick has the same rank as lifting."""
_INTERVALS = (
    "Whiskers: 95 % Wilson intervals where there is one training seed, else ± one "
    "standard deviation over the seeds."
)


def figures_of(entries: Sequence[PolicyResults]) -> list[Figure]:
    """Return all figures that are not empty.

    Ablations and results at control level appear in tables only. Language controls
    are plotted only if there is nothing else.
    """
    shown: list[PolicyResults] = []
    for left_out in (_NOT_PLOTTED, _NOT_PLOTTED[:2]):
        shown = shown or [
            entry for entry in entries if entry.results and entry.suite not in left_out
        ]
    return [figure for kind in ALL_KINDS for figure in _of_kind(shown, kind)]


def headline_figure(entries: Sequence[PolicyResults]) -> Figure:
    """Return success by task with high-level instructions.

    Args:
        entries: Results by policy, at least one with such instructions.
    """
    return next(_of_kind(entries, EVALUATION_KINDS[0]))


def stages_figure(
    entries: Sequence[PolicyResults], kind: str = EVALUATION_KINDS[0]
) -> Figure | None:
    """Return the furthest stages with one kind of instructions; None if unknown."""
    bars = [bar for entry in entries for bar in _furthest(entry, kind)]
    end = words(kind, "-")
    if not bars:
        return None
    return Figure(
        f"stages-{end}",
        f"Furthest stage, {end} instructions",
        "Strict episodes by the furthest stage of the expert's plan that they "
        "reached, in its first sub-task or in a later one; right, the success rate.",
        stacks(_STAGES, bars, "share of episodes [%]"),
    )


def write_figures(folder: Path, figures: Iterable[Figure]) -> None:
    """Write each figure as a self-contained SVG file."""
    for figure in figures:
        write_text(folder / f"{figure.name}.svg", standalone(figure.svg))


def _of_kind(entries: Sequence[PolicyResults], kind: str) -> Iterator[Figure]:
    entries = [entry for entry in entries if entry.has(kind)]
    if not entries:
        return
    end, tasks = words(kind, "-"), tasks_of(entries, kind)
    title = f"{end} instructions"
    mean = "mean" if set(tasks) == set(SUITE) else f"mean of {len(tasks)}"
    rows = (*tasks, mean)
    yield Figure(
        f"success-by-task-{end}",
        f"Success by task, {title}",
        f"Strict. {_INTERVALS} Strokes: what the paper reports, on another simulator.",
        dots(rows, [_by_task(entry, kind, tasks) for entry in entries], "success [%]"),
    )
    for name, axis in (("distractors", "number of distractors"), ("team", "team")):
        columns = values_of(entries, kind, name)
        series = [_by_column(entry, kind, name, columns) for entry in entries]
        yield Figure(
            f"success-by-{name}-{end}",
            f"Success by {axis}, {title}",
            f"{_INTERVALS} All tasks together.",
            lines([str(column) for column in columns], series, (axis, "success [%]")),
        )
    bars = [_causes(entry, kind) for entry in entries]
    if any(sum(bar.parts) for bar in bars):
        yield Figure(
            f"causes-{end}",
            f"Causes of failure, {title}",
            "Failed episodes by their first mistake; the rest of each bar succeeded.",
            stacks([words(c) for c in Cause], bars, "share of episodes [%]"),
        )
    staged = stages_figure(entries, kind)
    if staged:
        yield staged
    progress = [_progress(entry, kind, tasks) for entry in entries]
    yield Figure(
        f"progress-by-task-{end}",
        f"Progress by task, {title}",
        "Mean fraction of the goal that holds at the end. The line of each mark "
        "begins at the success rate: its length is what was done in failed episodes.",
        dots(rows, progress, "progress [%]"),
    )


def _by_task(entry: PolicyResults, kind: str, tasks: Sequence[str]) -> Series:
    marks = [_success(entry.select(kind, task=task)) for task in tasks]
    marks.append(_success(entry.select(kind), over_tasks=True))
    paper = entry.experiment.paper.get(kind) if entry.experiment else None
    if paper is not None:
        # The paper's mean is over all tasks of the suite.
        mean = paper.mean if set(tasks) == set(SUITE) else None
        figures = (*map(paper.tasks.get, tasks), mean)
        marks = list(map(_beside, marks, figures))
    return Series(entry.title, tuple(marks))


def _by_column(
    entry: PolicyResults, kind: str, name: str, columns: Sequence[object]
) -> Series:
    marks = (_success(entry.select(kind, **{name: column})) for column in columns)
    return Series(entry.title, tuple(marks))


def _success(seeds: list[list[Cell]], *, over_tasks: bool = False) -> Mark | None:
    """Return a success rate, from the cells of each seed."""
    filled = [cells for cells in seeds if cells]
    if not filled:
        return None
    rates = [
        mean_over_tasks(cells) if over_tasks else rate_of(cells).success_rate
        for cells in filled
    ]
    value = fmean(rates)
    if len(rates) > 1:
        spread = stdev(rates)
        low, high = max(0.0, value - spread), min(1.0, value + spread)
        text = f"{value:.1%} ± {spread:.1%} over {len(rates)} seeds"
    else:
        counted = rate_of(filled[0])
        low, high = counted.interval
        successes = f"{counted.successes} of {counted.episodes}"
        text = f"{value:.1%} ({low:.0%}–{high:.0%}), {successes}"
    # The mean over tasks may lie outside the interval over episodes.
    return Mark(value, min(low, value), max(high, value), text)


def _beside(mark: Mark | None, paper: Measured | None) -> Mark | None:
    if mark is None or paper is None:
        return mark
    text = f"{mark.words}; the paper: {paper} %"
    return Mark(mark.value, mark.low, mark.high, text, paper.mean / 100.0)


def _progress(entry: PolicyResults, kind: str, tasks: Sequence[str]) -> Series:
    marks: list[Mark | None] = []
    for task in tasks:
        found = [rate_of(c) for c in entry.select(kind, task=task) if c]
        solved = [rate.success_rate for rate in found]
        reached = [rate.progress for rate in found]
        marks.append(_dumbbell(fmean(solved), fmean(reached)) if found else None)
    known = [mark for mark in marks if mark is not None]
    solved = [mark.low for mark in known]
    marks.append(_dumbbell(fmean(solved), fmean(mark.value for mark in known)))
    return Series(entry.title, tuple(marks))


def _dumbbell(solved: float, reached: float) -> Mark:
    text = f"progress {reached:.1%}, success {solved:.1%}"
    return Mark(reached, solved, reached, text)


def _furthest(entry: PolicyResults, kind: str) -> Iterator[Bar]:
    """Yield the bar of a policy, if its results have stages."""
    found = [
        one for result in entry.results for one in result.reached if one.kind == kind
    ]
    episodes = sum(one.episodes for one in found)
    if not episodes:
        return
    counted: Counter[str] = Counter()
    for one in found:
        for label, count in one.stages.items():
            number, _, stage = label.partition(" ")
            stage = Stage.LIFTED if stage == Stage.DRAGGED else stage
            part = f"{_FIRST if number == '1' else _LATER} {stage}" if stage else _NONE
            counted[part] += count
    solved = fmean(mean_over_tasks(cells) for cells in entry.select(kind) if cells)
    shares = tuple(counted[part] / episodes for part in _STAGES)
    yield Bar(entry.title, f"{solved:.1%}", shares)


def _causes(entry: PolicyResults, kind: str) -> Bar:
    counted, episodes = entry.causes(kind), entry.episodes(kind)
    return Bar(
        entry.title,
        f"{counted.total()} of {episodes}",
        tuple(counted[cause] / episodes for cause in Cause),
    )
