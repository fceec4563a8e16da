"""The page of `lemma inspect`: what is in a recipe, in one HTML file."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from lemma.dataset.recipe.balance import (
    ALL,
    LEAST_EXPECTED,
    TEAM_NAMES,
    Balance,
    Evenness,
)
from lemma.dataset.recipe.statistics import GroupSummary, Statistics
from lemma.scene.palette import OBJECT_COLORS
from lemma.viz.pages.templates import fill
from lemma.viz.plots import Bar, histogram, ranges, stacks

_FILLS = {
    **{
        name: "#" + "".join(f"{round(255 * c):02x}" for c in OBJECT_COLORS[name][:3])
        for name in OBJECT_COLORS
    },
    **dict(zip(TEAM_NAMES, ("#9fc3e4", "#4a7fb5", "#1f4568"), strict=True)),
}
_HEADINGS = {
    "episodes": "",
    "solved": "",
    "sub-tasks": "mean",
    "objects": "",
    "distractors": "",
    "time": "mean, simulated",
    "margin": "least, to the edge of reach",
}
_EXPLANATION = (
    "Colors and teams are drawn evenly by design: bars should be divided at the "
    "dotted lines. p is the probability of counts at least as uneven (chi-square "
    f"test); there is none where fewer than {LEAST_EXPECTED} of each are expected."
)


@dataclass(frozen=True, slots=True)
class Section:
    """A plot of the page."""

    title: str
    text: str
    svg: str


def write_dataset_page(
    path: Path, name: str, found: Statistics, versions: dict[str, str], size_mb: float
) -> None:
    """Write the page.

    Args:
        path: The HTML file.
        name: Name of the recipe.
        found: What is in it.
        versions: What it was written with.
        size_mb: Size of its files [MB].
    """
    evenness = found.evenness
    unknown = evenness.smallest_p is None
    page = fill(
        "dataset.html",
        title=f"Recipe {name}",
        tiles=list(_tiles(found, size_mb)),
        headings=_HEADINGS,
        groups={
            "by task": _rows(found.tasks),
            "by split": _rows(found.splits),
            "by team": _rows(found.teams),
            "": _rows({ALL: found.total}),
        },
        cells=_rows(found.cells),
        parts={
            "": [*_times(found), _margins(found), _distractors(found)],
            "Is it balanced?": [_balance(found, one) for one in found.balances],
            **(
                {"What was turned down": list(_rejections(found))}
                if found.rejections
                else {}
            ),
        },
        verdict=verdict_words(evenness),
        verdict_kind="faint" if unknown else "good" if evenness.even else "bad",
        explanation=_EXPLANATION,
        footer="Written with " + ", ".join(map(" ".join, versions.items())),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")


def table_cells(group: GroupSummary) -> dict[str, str]:
    """Return the numbers of a group in words: by heading."""
    objects, more = group.objects, group.distractors
    cells = (
        f"{group.episodes}",
        f"{group.solved / group.episodes:.0%}",
        f"{group.subtasks.mean:.2f}",
        f"{objects.least:.0f}–{objects.most:.0f}",
        f"{more.least:.0f}–{more.most:.0f}",
        f"{group.elapsed_s.mean:.1f} s",
        f"{100 * group.margin_m.least:.1f} cm",
    )
    return dict(zip(_HEADINGS, cells, strict=True))


def p_words(balance: Balance) -> str:
    """Return a p-value in words, or a dash where there are too few to test."""
    if balance.p_value is None:
        return "–"
    return "<0.01" if balance.p_value < 0.01 else f"{balance.p_value:.2f}"


def verdict_words(found: Evenness) -> str:
    """Return whether what was drawn is even, in a sentence."""
    if found.smallest_p is None:
        return "Too few episodes to say whether what was drawn is even."
    numbers = (
        f"{found.tests} chi-square tests, smallest p {found.smallest_p:.2g} (uneven "
        f"is below {found.limit:.1g})"
    )
    if found.even:
        return f"What was drawn is even within sampling noise: {numbers}."
    return f"What was drawn is not even: {numbers}."


def _tiles(found: Statistics, size_mb: float) -> Iterator[tuple[str, str]]:
    total = found.total
    hours = total.elapsed_s.mean * total.episodes / 3600
    yield f"{total.episodes:,}", "episodes"
    yield f"{total.solved / total.episodes:.1%}", "solved"
    yield f"{round(total.subtasks.mean * total.episodes):,}", "sub-tasks"
    yield f"{hours:.1f} h", "simulated"
    yield f"{total.idle_share:.0%}", "idle, per robot"
    yield f"{size_mb:.1f} MB", "on disk"


def _rows(groups: Mapping[str, GroupSummary]) -> list[tuple[str, ...]]:
    return [(name, *table_cells(group).values()) for name, group in groups.items()]


def _times(found: Statistics) -> Iterator[Section]:
    groups = {name: group.elapsed_s for name, group in found.tasks.items()}
    for what, spreads, text in (
        ("an episode", groups, "From the shortest to the longest; dots are means."),
        ("a primitive", found.primitives_s, "The same for every sub-task."),
    ):
        rows = [(n, one.least, one.mean, one.most) for n, one in spreads.items()]
        plot = ranges(rows, "s", "simulated time")
        yield Section(f"Simulated time of {what}", text, plot)


def _margins(found: Statistics) -> Section:
    margins = [100 * margin for fact in found.facts for margin in fact.margins_m]
    return Section(
        "Reach margin",
        "How far inside the reach of the robot that acts its gripper closes, and where "
        "it ends. Below zero only a tool is led.",
        histogram(margins, "cm", "distance to the edge of reach", "gripper poses"),
    )


def _distractors(found: Statistics) -> Section:
    numbers = range(int(found.total.distractors.most) + 1)
    bars = []
    for task, group in found.tasks.items():
        counts = dict.fromkeys(numbers, 0)
        for fact in found.facts:
            counts[fact.distractors] += fact.task == task
        bars.append(_bar(task, table_cells(group)["distractors"], counts.values()))
    return Section(
        "Distractors",
        "Objects that the goal does not need.",
        stacks([str(number) for number in numbers], bars, "share of episodes [%]"),
    )


def _balance(found: Statistics, name: str) -> Section:
    balances = {
        task: found.balances[name][task]
        for task in (*found.tasks, ALL)
        if task in found.balances[name]
    }
    bars = [
        _bar(task, f"p {p_words(balance)}", balance.counts.values())
        for task, balance in balances.items()
    ]
    parts = list(next(iter(balances.values())).counts) if balances else []
    fills = [_FILLS[part] for part in parts]
    plot = stacks(parts, bars, "share of episodes [%]", fills, even=len(parts))
    return Section(name[0].upper() + name[1:], "", plot)


def _rejections(found: Statistics) -> Iterator[Section]:
    """Tell what was turned down, before there were episodes."""
    turned_down = found.rejections.items()
    for who, text, shares, axis in (
        (
            "sampler",
            "While the frozen lists of these splits were made: tables on which "
            "somebody reaches what the task forbids.",
            {task: one.sampler_rate for task, one in turned_down},
            "share of tables [%]",
        ),
        (
            "expert",
            "Of the instances that were left: those that it did not solve as the task "
            f"promises, {sum(one.by_expert for _, one in turned_down)} in all.",
            {task: one.expert_rate for task, one in turned_down},
            "share of instances [%]",
        ),
    ):
        bars = [Bar(task, f"{share:.1%}", (share,)) for task, share in shares.items()]
        yield Section(f"Rejected by the {who}", text, stacks(["rejected"], bars, axis))


def _bar(label: str, note: str, counts: Iterable[int]) -> Bar:
    numbers = list(counts)
    total = sum(numbers) or 1
    return Bar(label, note, tuple(number / total for number in numbers))
