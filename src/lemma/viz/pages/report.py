"""The page of `lemma report`: tables, figures and failures in one HTML file."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from shlex import quote
from string import Template
from typing import Any

from lemma import __version__
from lemma.dataset.files import write_text
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.analysis.intervals import mean_over_tasks
from lemma.evaluation.records import Departure
from lemma.evaluation.report.episodes import (
    DEPARTURES,
    Case,
    explanation,
    subtask_words,
)
from lemma.evaluation.report.latex import latex
from lemma.evaluation.report.policy_results import PolicyResults, shown
from lemma.evaluation.report.sections import Section, protocol_words, sections
from lemma.evaluation.report.tables import NOT_RUN, ResultTable, markdown, words
from lemma.evaluation.run.language_controls import FULL
from lemma.policies.spec import PLANNINGS
from lemma.serve.client.websocket import is_address
from lemma.tasks.language.template import KINDS
from lemma.viz.figures import Figure
from lemma.viz.pages.demo import data_uri
from lemma.viz.pages.report_figures import figures_of
from lemma.viz.pages.report_pictures import Pictures

PAGE = "index.html"
_INLINE = (
    (re.compile(r"\[([^]]*)\]\(([^)]*)\)"), r"\1"),
    (re.compile(r"`([^`]+)`"), r"<code>\1</code>"),
    (re.compile(r"\*\*([^*]+)\*\*"), r"<b>\1</b>"),
    (re.compile(r"\*([^*]+)\*"), r"<em>\1</em>"),
)
_RATE = re.compile(r"^(?:≈ )?([\d.]+)(?: |$)")
_BRACKETS = re.compile(r" (\([^)]*\)|± [\d.]+)$")
"""Intervals and spreads, which stand back behind what they are of."""
_PAPER = "*paper*"


@dataclass(frozen=True)
class Findings:
    """What a page shows besides the results."""

    cases: Sequence[Case] = ()
    """Episodes, by policy."""
    pictures: Mapping[int, Pictures] = field(default_factory=dict)
    """By number of the episode."""
    missing: str = ""
    """Why pictures are missing, in a sentence; empty if none are."""


def write_report_page(
    path: Path, entries: Sequence[PolicyResults], found: Findings | None = None
) -> None:
    """Write the page.

    Args:
        path: The HTML file.
        entries: What it reports.
        found: Episodes and pictures, if there are any.
    """
    found = found or Findings()
    first = glance(entries)
    tables = [one for one in sections(entries) if one.table.rows]
    figures = figures_of(entries)
    data = {
        "tables": {one.name: _copies(one) for one in (first, *tables)},
        "failures": failures_data(found),
    }
    page = Template(_file("report.html")).substitute(
        title="LEMMA Bench: a report",
        style=_file("report.css"),
        script=_file("report.js"),
        lead=_inline(protocol_words(entries)),
        tiles="\n".join(_tiles(entries, found)),
        glance=_table_card(first),
        contents="".join(
            f'<li><a href="#{one.name}">{escape(one.title)}</a></li>' for one in tables
        ),
        figures="\n".join(map(_figure_card, figures)),
        tables="\n".join(map(_table_card, tables)),
        missing=f"<p>{escape(found.missing)}</p>" if found.missing else "",
        data=_embedded(data),
        footer=f"Written by lemma {__version__}.",
    )
    write_text(path, page)


def glance(entries: Sequence[PolicyResults]) -> Section:
    """Return the mean success of every policy with every kind of instructions."""
    kinds = [kind for kind in KINDS if any(entry.has(kind) for entry in entries)]
    rows = [
        (
            entry.title,
            *(
                shown(entry.select(kind), mean_over_tasks) if entry.results else NOT_RUN
                for kind in kinds
            ),
        )
        for entry in entries
    ]
    header = ("mean over the tasks [%]", *(words(kind, "-") for kind in kinds))
    return Section("At a glance", "", ResultTable(header, tuple(rows)))


def failures_data(found: Findings) -> dict[str, Any]:
    """Return what the page's script shows and filters: plain data, ready for JSON."""
    policies = list(dict.fromkeys(case.policy for case in found.cases))
    return {
        "policies": policies,
        "causes": {str(cause): words(cause) for cause in Cause},
        "kinds": {kind: words(kind, "-") for kind in KINDS},
        "cases": [
            _case_data(case, policies.index(case.policy), found.pictures.get(i))
            for i, case in enumerate(found.cases)
        ],
    }


def demo_command(case: Case) -> str:
    """Return the command that lets the policy play again; ``""`` if none does."""
    row, policy = case.row, case.about["policy"]
    seeds = {told["seed"] for told in case.about["weights"].values()}
    same = (
        # Weights of other training seeds are found by their path alone.
        (seeds <= {0} or "/" in policy["name"])
        and row["instruction_kind"] == KINDS[0]
        and case.about["language"] == FULL
        and not row.get("perturb_start", False)
        and policy["planning"] == PLANNINGS[0]
        and not policy["gta"]
        and not is_address(policy["name"])
    )
    if not same:
        return ""
    return (
        f"lemma demo {row['task']} --split {row['split']} --index {row['index']} "
        f"--policy {quote(policy['name'])}"
    )


def video_command(case: Case) -> str:
    """Return the command that films an episode as it was, whatever the policy."""
    folder = quote(str(case.folder))
    return f"lemma report {folder} --episode {case.name} --videos --out out/film"


def _case_data(case: Case, policy: int, pictures: Pictures | None) -> dict[str, Any]:
    row = case.row
    data: dict[str, Any] = {
        "id": f"{policy}/{case.name}",
        "policy": policy,
        "kind": row["instruction_kind"],
        "task": row["task"],
        "index": row["index"],
        "team": row["team"],
        "distractors": row["distractors"],
        "sentence": row["instruction"],
        "cause": str(case.cause) if case.cause else "",
        "outcome": row["failure"] or "solved",
    }
    if case.cause is None:
        return data
    data |= {
        "why": explanation(case),
        "progress": row["progress"],
        "elapsed_s": row.get("elapsed_s"),
        "mistake": case.mistake,
        "steps": [_step_data(case, step) for step in row["subtasks"]],
        "demo": demo_command(case),
        "film": video_command(case),
    }
    if pictures is not None:
        data |= {
            "map": data_uri("image/jpeg", pictures.map),
            "before": data_uri("image/jpeg", pictures.before),
            "after": data_uri("image/jpeg", pictures.after),
            "differs": pictures.differs,
            "video": pictures.video,
        }
    return data


def _step_data(case: Case, step: Mapping[str, Any]) -> dict[str, Any]:
    said = step["expert"]
    departs = Departure(said["departure"])
    errors = [
        f"{end} {said[f'{end}_error_mm']:.0f} mm off"
        for end in ("pick", "place")
        if said[f"{end}_error_mm"] is not None and departs is Departure.NONE
    ]
    return {
        "words": subtask_words(case, step),
        "posed": step.get("grounded") is not None,
        "outcome": step["outcome"],
        "explanation": step.get("explanation", ""),
        "duration_s": step.get("duration_s"),
        "departs": DEPARTURES.get(departs, ""),
        "expert": subtask_words(case, said["expected"]) if departs else "",
        "errors": ", ".join(errors),
    }


def _copies(section: Section) -> dict[str, str]:
    caption = section.title
    return {
        "latex": latex(section.table, f"{caption}.", f"tab:{section.name}"),
        "markdown": markdown(section.table),
    }


def _embedded(data: object) -> str:
    """Return data for a script element, which nothing in a name can close."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")


def _file(name: str) -> str:
    return (files("lemma.viz.pages") / name).read_text(encoding="utf-8")


def _inline(text: str) -> str:
    """Return a line of Markdown as HTML."""
    html = escape(text)
    for mark, element in _INLINE:
        html = mark.sub(element, html)
    return html


def _tiles(entries: Sequence[PolicyResults], found: Findings) -> Iterator[str]:
    cells = [c for entry in entries for result in entry.results for c in result.cells]
    episodes = sum(cell.episodes for cell in cells)
    failed = episodes - sum(cell.successes for cell in cells)
    policies = sum(bool(entry.results) for entry in entries)
    for number, what in (
        (policies, "policy" if policies == 1 else "policies"),
        (episodes, "episodes"),
        (failed, "of them failed"),
        (sum(case.cause is not None for case in found.cases), "failures to look at"),
        (len(found.pictures), "with pictures"),
    ):
        yield f"<div><b>{number:,}</b><span>{what}</span></div>"


def _table_card(section: Section) -> str:
    table = section.table
    note = f"<p>{_inline(section.note)}</p>" if section.note else ""
    head = f'<h3 id="{section.name}">{escape(section.title)}</h3>{note}'
    buttons = "".join(
        f'<button type="button" data-copy="{form.lower()}" data-table="{section.name}">'
        f"Copy {form}</button>"
        for form in ("LaTeX", "Markdown")
    )
    header = "".join(
        f"<th{_kind(table, i)}>{_inline(cell)}</th>"
        for i, cell in enumerate(table.header)
    )
    rates = table.header[0].endswith("[%]")
    rows = "\n".join(_row(table, row, rates=rates) for row in table.rows)
    return (
        f'<section class="table">{head}<p class="buttons">{buttons}</p>'
        f'<div class="scroll" tabindex="0" role="region" '
        f'aria-label="{escape(section.title)}"><table><thead><tr>{header}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div></section>"
    )


def _row(table: ResultTable, row: tuple[str, ...], *, rates: bool) -> str:
    paper = row[0] == _PAPER
    cells = []
    for i, cell in enumerate(row):
        found = _RATE.match(cell) if rates and i >= table.labels else None
        share = f' style="--share:{found[1]}%"' if found else ""
        kind = _kind(table, i)
        shown_cell = _inline(cell)
        if i >= table.labels:
            shown_cell = _BRACKETS.sub(r" <small>\1</small>", shown_cell)
        cells.append(f"<td{kind}{share}>{shown_cell}</td>")
    style = ' class="paper"' if paper else ""
    return f"<tr{style}>{''.join(cells)}</tr>"


def _kind(table: ResultTable, column: int) -> str:
    return "" if column < table.labels else ' class="number"'


def _figure_card(figure: Figure) -> str:
    return (
        f'<figure class="plot" id="{figure.name}"><h3>{escape(figure.title)}</h3>'
        f'<div class="scroll" tabindex="0" role="region" '
        f'aria-label="{escape(figure.title)}">{figure.svg}</div>'
        f"<figcaption>{escape(figure.caption)}</figcaption>"
        f'<p class="buttons"><button type="button" data-svg="{figure.name}">'
        "Download SVG</button></p></figure>"
    )
