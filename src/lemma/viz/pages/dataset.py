"""The page of `lemma inspect`: what is in a recipe, in one HTML file."""

from collections.abc import Iterator
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from lemma.dataset.recipe.balance import (
    ALL,
    LEAST_EXPECTED,
    TEAM_NAMES,
    Balance,
    Evenness,
)
from lemma.dataset.recipe.statistics import GroupSummary, Statistics
from lemma.scene.palette import OBJECT_COLORS
from lemma.viz.charts import Part, Range, histogram, legend, ranges, rates, stacked

_FILLS = {
    **{
        name: f"rgb({', '.join(f'{255 * c:.0f}' for c in OBJECT_COLORS[name][:3])})"
        for name in OBJECT_COLORS
    },
    **dict(
        zip(TEAM_NAMES, ("var(--low)", "var(--middle)", "var(--high)"), strict=True)
    ),
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
    "dashed lines. p is the probability of counts at least as uneven (chi-square "
    f"test); there is none where fewer than {LEAST_EXPECTED} of each are expected."
)


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
    template = (files("lemma.viz.pages") / "dataset.html").read_text(encoding="utf-8")
    page = Template(template).substitute(
        title=f"Recipe {escape(name)}",
        tiles="\n".join(_tiles(found, size_mb)),
        headings="".join(
            f"<th>{name}<small>{note}</small></th>" for name, note in _HEADINGS.items()
        ),
        groups="\n".join(
            _rows(title, rows)
            for title, rows in (
                ("task", found.tasks),
                ("split", found.splits),
                ("team", found.teams),
                ("", {ALL: found.total}),
            )
        ),
        cells=_rows("task / split / team", found.cells),
        sections="\n".join(_sections(found)),
        footer=escape("Written with " + ", ".join(map(" ".join, versions.items()))),
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


def _verdict(found: Evenness) -> str:
    kind = "faint" if found.smallest_p is None else "good" if found.even else "bad"
    return f'<p class="verdict {kind}">{escape(verdict_words(found))}</p>'


def _tiles(found: Statistics, size_mb: float) -> Iterator[str]:
    total = found.total
    hours = total.elapsed_s.mean * total.episodes / 3600
    subtasks = round(total.subtasks.mean * total.episodes)
    for number, words in (
        (f"{total.episodes:,}", "episodes"),
        (f"{total.solved / total.episodes:.1%}", "solved"),
        (f"{subtasks:,}", "sub-tasks"),
        (f"{hours:.1f} h", "simulated"),
        (f"{total.idle_share:.0%}", "idle, per robot"),
        (f"{size_mb:.1f} MB", "on disk"),
    ):
        yield f"<div><b>{number}</b><span>{words}</span></div>"


def _rows(title: str, groups: dict[str, GroupSummary]) -> str:
    """Return the rows of a table for some groups, under a title."""
    head = f'<tr class="title"><th colspan="8">by {title}</th></tr>' if title else ""
    kind = "" if title else ' class="total"'
    rows = (
        f"<tr{kind}>"
        + "".join(f"<td>{escape(c)}</td>" for c in (name, *table_cells(group).values()))
        + "</tr>"
        for name, group in groups.items()
    )
    return f"<tbody>{head}{''.join(rows)}</tbody>"


def _sections(found: Statistics) -> Iterator[str]:
    yield _section(
        "Simulated time of an episode",
        "From the shortest to the longest; the dot and the number are the mean.",
        ranges(
            [_range(name, group) for name, group in found.tasks.items()],
            "s",
            "simulated time of an episode",
        ),
    )
    yield _section(
        "Simulated time of a primitive",
        "The same for every sub-task, over all tasks.",
        ranges(
            [
                Range(name, spread.least, spread.mean, spread.most)
                for name, spread in found.primitives_s.items()
            ],
            "s",
            "simulated time of a sub-task",
        ),
    )
    margins = [100 * margin for fact in found.facts for margin in fact.margins_m]
    yield _section(
        "Reach margin",
        "How far inside the reach of the robot that acts its gripper closes, and where "
        "it ends. Below zero only a tool is led.",
        histogram(margins, "cm", "distance to the edge of reach", "gripper poses"),
    )
    yield _distractor_section(found)
    yield (
        '<header class="wide"><h2>Is it balanced?</h2>'
        f"{_verdict(found.evenness)}<p>{escape(_EXPLANATION)}</p></header>"
    )
    for name in found.balances:
        yield _balance_section(found, name)
    yield '<header class="wide"><h2>What was turned down</h2></header>'
    yield from _rejection_sections(found)


def _range(name: str, group: GroupSummary) -> Range:
    spread = group.elapsed_s
    return Range(name, spread.least, spread.mean, spread.most)


def _balance_section(found: Statistics, name: str) -> str:
    balances = found.balances[name]
    rows, parts = [], []
    for task in (*found.tasks, ALL):
        if task in balances:
            counts = balances[task].counts
            parts = [Part(k, v, _FILLS[k]) for k, v in counts.items()]
            rows.append((task, parts, f"p {p_words(balances[task])}"))
    return _section(
        name[0].upper() + name[1:],
        "",
        legend(parts) + stacked(rows, "share of episodes", len(parts)),
    )


def _distractor_section(found: Statistics) -> str:
    most = int(found.total.distractors.most)
    shades = [
        f"color-mix(in srgb, var(--bar) {100 * i // max(most, 1)}%, var(--card))"
        for i in range(most + 1)
    ]
    rows = []
    parts: list[Part] = []
    for task, group in found.tasks.items():
        counts = [0] * (most + 1)
        for fact in found.facts:
            counts[fact.distractors] += fact.task == task
        parts = [
            Part(str(i), n, shade)
            for i, (n, shade) in enumerate(zip(counts, shades, strict=True))
        ]
        rows.append((task, parts, table_cells(group)["distractors"]))
    return _section(
        "Distractors",
        "Objects that the goal does not need.",
        legend(parts) + stacked(rows, "share of episodes"),
    )


def _rejection_sections(found: Statistics) -> Iterator[str]:
    """Tell what was turned down, before there were episodes."""
    turned_down = found.rejections.items()
    yield _section(
        "Rejected by the sampler",
        "While the frozen lists of these splits were made: tables on which somebody "
        "reaches what the task forbids.",
        rates([(t, r.sampler_rate) for t, r in turned_down], "share of tables"),
    )
    yield _section(
        "Rejected by the expert",
        "Of the instances that were left: those that it did not solve as the task "
        f"promises, {sum(r.by_expert for _, r in turned_down)} in all.",
        rates([(t, r.expert_rate) for t, r in turned_down], "share of instances"),
    )


def _section(title: str, text: str, content: str) -> str:
    words = f"<p>{escape(text)}</p>" if text else ""
    return f"<section><h2>{escape(title)}</h2>{words}{content}</section>"
