"""The page of `lemma inspect`: what is in a recipe, in one HTML file."""

from collections.abc import Iterator
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from lemma.cli.charts import Part, Range, bars, histogram, legend, ranges, stacked
from lemma.dataset.statistics import ALL, TEAM_NAMES, GroupSummary, Statistics

_TEAM_INKS = ("low", "middle", "high")
_FILLS = {
    **{"pink": "#f273ad", "red": "#cc1a1a", "white": "#f2f2ed"},
    **{"blue": "#1a47c7", "green": "#1a8c38"},
    **dict(
        zip(TEAM_NAMES, ("var(--low)", "var(--middle)", "var(--high)"), strict=True)
    ),
}
_HEADINGS = (
    *("episodes", "solved", "sub-tasks", "objects", "distractors"),
    *("seconds", "margin"),
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
    total = found.total
    splits = ", ".join(f"{k} {group.episodes}" for k, group in found.splits.items())
    lead = (
        f"{total.episodes} episodes ({splits}), {total.solved} of them solved; "
        f"{total.elapsed_s.mean * total.episodes / 3600:.1f} simulated hours; "
        f"{size_mb:.1f} MB."
    )
    rows = [*found.tasks.items(), (ALL, total)]
    template = (files("lemma.cli") / "dataset.html").read_text(encoding="utf-8")
    page = Template(template).substitute(
        title=f"Recipe {escape(name)}",
        lead=escape(lead),
        headings="".join(f"<th>{heading}</th>" for heading in ("task", *_HEADINGS)),
        rows="\n".join(_row(task, group) for task, group in rows),
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
        f"{group.subtasks.mean:.2g}",
        f"{objects.least:.0f}-{objects.most:.0f}",
        f"{more.least:.0f}-{more.most:.0f}",
        f"{group.elapsed_s.mean:.1f}",
        f"{100 * group.margin_m.least:.1f} cm",
    )
    return dict(zip(_HEADINGS, cells, strict=True))


def _row(name: str, group: GroupSummary) -> str:
    cells = (name, *table_cells(group).values())
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"


def _sections(found: Statistics) -> Iterator[str]:
    rows = [_range(name, group) for name, group in found.tasks.items()]
    yield _section(
        "Simulated time of an episode",
        "From the shortest to the longest; the dot is the mean.",
        ranges(rows, "s", "Simulated time per task"),
    )
    yield _section(
        "Simulated time of a primitive",
        "The same, over all tasks.",
        ranges(
            [
                Range(name, spread.least, spread.mean, spread.most)
                for name, spread in found.primitives_s.items()
            ],
            "s",
            "Simulated time per primitive",
        ),
    )
    for name in found.balances:
        yield _balance_section(found, name)
    yield _distractor_section(found)
    margins = [margin for fact in found.facts for margin in fact.margins_m]
    yield _section(
        "Reach margin",
        "How far inside the reach of the robot that acts its gripper closes, and where "
        "it ends.",
        histogram(margins, "m", "Histogram of reach margins"),
    )
    yield _rejection_section(found)


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
            rows.append((task, parts, f"p {balances[task].p_value:.2f}"))
    return _section(
        name[0].upper() + name[1:],
        "Drawn evenly by design. p: the probability of counts at least this uneven "
        "(chi-square test); one in a hundred is below 0.01 by chance.",
        legend(parts) + stacked(rows, name),
    )


def _distractor_section(found: Statistics) -> str:
    most = int(found.total.distractors.most)
    shades = [
        f"color-mix(in srgb, var(--bar) {100 * i // max(most, 1)}%, var(--card))"
        for i in range(most + 1)
    ]
    rows = []
    parts: list[Part] = []
    for task in found.tasks:
        counts = [0] * (most + 1)
        for fact in found.facts:
            counts[fact.distractors] += fact.task == task
        parts = [
            Part(str(i), n, shade)
            for i, (n, shade) in enumerate(zip(counts, shades, strict=True))
        ]
        low, high = (int(v) for v in _ends(found.tasks[task]))
        rows.append((task, parts, f"{low}-{high}"))
    return _section(
        "Distractors",
        "Objects that the goal does not need.",
        legend(parts) + stacked(rows, "Distractors per task"),
    )


def _ends(group: GroupSummary) -> tuple[float, float]:
    return group.distractors.least, group.distractors.most


def _rejection_section(found: Statistics) -> str:
    tables = [(task, r.sampler_rate) for task, r in found.rejections.items()]
    instances = [(task, r.expert_rate) for task, r in found.rejections.items()]
    refused = (
        "<p>Sampled instances that the expert did not solve as the task promises.</p>"
        + _rates(instances, "Instances that the expert did not solve")
    )
    if not any(rate for _, rate in instances):
        refused = "<p>The expert solved every instance that was sampled.</p>"
    return _section(
        "Turned down while the lists were frozen",
        "Tables that the sampler turned down because they violate the task's zones.",
        _rates(tables, "Tables that the sampler turned down") + refused,
    )


def _rates(rates: list[tuple[str, float]], title: str) -> str:
    return bars([(task, rate, f"{rate:.1%}") for task, rate in rates], title)


def _section(title: str, text: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2><p>{escape(text)}</p>{content}</section>"
