"""The page of `lemma report`: tables, figures and failures in one HTML file."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import Any

from markupsafe import Markup

from lemma.core.files import write_text
from lemma.core.tables import Table
from lemma.core.version import VERSION as __version__
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.lines import result_beside
from lemma.evaluation.protocol.language_controls import FULL
from lemma.evaluation.records import Deviation
from lemma.evaluation.report.episodes import (
    DEVIATION_WORDS,
    Case,
    explanation,
    subtask_words,
)
from lemma.evaluation.report.policy_results import PolicyResults
from lemma.evaluation.report.sections import (
    SUCCESS,
    Section,
    protocol_words,
    sample_words,
    sections,
)
from lemma.evaluation.report.tables import at_a_glance, words
from lemma.policies.spec import PLANNINGS
from lemma.serve.websocket import is_address
from lemma.tasks.language.template import ALL_KINDS, EVALUATION_KINDS
from lemma.viz.pages.report_figures import figures_of
from lemma.viz.pages.report_pictures import Pictures
from lemma.viz.pages.templates import data_uri, fill, inline
from lemma.viz.recording import judged, reached_words, trained_words

PAGE = "index.html"
_RATE = re.compile(r"^(?:≈ )?([\d.]+)(?: |$)")
_BRACKETS = re.compile(r" (\([^)]*\)|± [\d.]+)(?=$| †$)")
"""Intervals and standard deviations, which are written smaller."""


@dataclass(frozen=True)
class Findings:
    """Episodes and pictures of a page, besides the results.

    The number of an episode is its index in :attr:`cases`.
    """

    cases: Sequence[Case] = ()
    """Episodes, sorted by policy."""
    pictures: Mapping[int, Pictures] = field(default_factory=dict)
    """Pictures, by number of the episode."""
    missing: str = ""
    """The reason why pictures are missing, as a sentence; empty if none are missing."""
    replays: Mapping[int, str] = field(default_factory=dict)
    """File names of replays in the same folder, by number of the episode."""
    beside: Mapping[int, tuple[tuple[int, str], ...]] = field(default_factory=dict)
    """Number and policy of the episodes to compare an episode with, by its number."""


def write_report_page(
    path: Path, entries: Sequence[PolicyResults], found: Findings | None = None
) -> None:
    """Write the page.

    Args:
        path: The HTML file.
        entries: Results by policy.
        found: Episodes and pictures, if there are any.
    """
    found, samples = found or Findings(), sample_words(entries)
    glance = Section("At a glance", "", at_a_glance(entries), SUCCESS, samples)
    tables = [one for one in sections(entries) if one.table.rows]
    copies = {
        one.name: {
            "latex": one.table.latex(f"{one.title}.", f"tab:{one.name}"),
            "markdown": one.table.markdown(),
        }
        for one in (glance, *tables)
    }
    page = _page(
        found,
        copies,
        title="LEMMA Bench: a report",
        lead=protocol_words(entries),
        tiles=list(_tiles(entries, found)),
        glance=glance,
        figures=figures_of(entries),
        tables=tables,
        share=_share,
        number=_number,
    )
    write_text(path, page)


def failures_page(found: Findings) -> str:
    """Return a page with the failures alone."""
    empty = dict.fromkeys(("lead", "tiles", "glance", "figures", "tables"), ())
    return _page(found, {}, title="LEMMA Bench: failures", **empty)


def _page(found: Findings, copies: Mapping[str, Any], **values: Any) -> str:
    return fill(
        "report.html",
        missing=found.missing,
        data={"tables": copies, "failures": failures_data(found)},
        footer=f"Written by lemma {__version__}.",
        **values,
    )


def failures_data(found: Findings) -> dict[str, Any]:
    """Return the data of the page's script, ready for JSON."""
    policies = list(dict.fromkeys(case.policy for case in found.cases))
    return {
        "policies": policies,
        "causes": {str(cause): words(cause) for cause in Cause},
        "kinds": {kind: words(kind, "-") for kind in ALL_KINDS},
        "cases": [
            _case_data(case, policies.index(case.policy), found.pictures.get(i))
            | {"replay": found.replays.get(i, ""), "beside": found.beside.get(i, ())}
            for i, case in enumerate(found.cases)
        ],
    }


def demo_command(case: Case) -> str:
    """Return a command that plays the episode with its policy; ``""`` if none can."""
    row, policy = case.row, case.about["policy"]
    seeds = {entry.get("seed", 0) for entry in case.about["weights"].values()}
    same = (
        # Weights of other training seeds have no name, only a path.
        (seeds <= {0} or "/" in policy["name"])
        and row["instruction_kind"] == EVALUATION_KINDS[0]
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
    """Return a command that renders a video of an episode from its line."""
    result = quote(str(result_beside(case.lines)))
    return f"lemma report {result} --episode {case.name} --videos --out out/film"


def _case_data(case: Case, policy: int, pictures: Pictures | None) -> dict[str, Any]:
    row = case.row
    data: dict[str, Any] = {
        "id": f"{policy}/{case.name}",
        "policy": policy,
        "kind": row["instruction_kind"],
        "sentence": row["instruction"],
        **{name: row[name] for name in ("task", "index", "team", "distractors")},
        "cause": str(case.cause) if case.cause else "",
        "outcome": row["failure"] or "solved",
    }
    if case.cause is None:
        return data
    data |= {
        "why": explanation(case),
        "progress": row["progress"],
        "reached": reached_words(row["stages"]),
        "judged": judged(row["stages"]),
        "trained": trained_words(case.about["weights"]),
        "elapsed_s": row.get("elapsed_s"),
        "mistake": case.mistake,
        "steps": [_step_data(case, step) for step in row["subtasks"]],
        "demo": demo_command(case),
        "film": video_command(case),
    }
    if pictures is not None:
        for name in ("map", "before", "after"):
            data[name] = data_uri("image/jpeg", getattr(pictures, name))
        for name in ("differs", "video", "gantt"):
            data[name] = getattr(pictures, name)
    return data


def _step_data(case: Case, step: Mapping[str, Any]) -> dict[str, Any]:
    feedback = step["expert"]
    departs = Deviation(feedback["departure"])
    errors = [
        f"{end} {feedback[f'{end}_error_mm']:.0f} mm off"
        for end in ("pick", "place")
        if feedback[f"{end}_error_mm"] is not None and departs is Deviation.NONE
    ]
    return {
        "words": subtask_words(case, step),
        "posed": step.get("grounded") is not None,
        "outcome": step["outcome"],
        "explanation": step.get("explanation", ""),
        "duration_s": step.get("duration_s"),
        "departs": DEVIATION_WORDS.get(departs, ""),
        "expert": subtask_words(case, feedback["expected"]) if departs else "",
        "errors": ", ".join(errors),
    }


def _tiles(
    entries: Sequence[PolicyResults], found: Findings
) -> Iterator[tuple[int, str]]:
    cells = [c for entry in entries for result in entry.results for c in result.cells]
    episodes = sum(cell.episodes for cell in cells)
    failed = episodes - sum(cell.successes for cell in cells)
    policies = sum(bool(entry.results) for entry in entries)
    yield policies, "policy" if policies == 1 else "policies"
    yield episodes, "episodes"
    yield failed, "of them failed"
    yield sum(case.cause is not None for case in found.cases), "failures to look at"
    yield len(found.pictures), "with pictures"


def _share(table: Table, cell: str) -> str:
    """Return the rate at the start of a cell [%]; ``""`` if there is none."""
    rate = _RATE.match(cell) if table.header[0].endswith("[%]") else None
    return rate[1] if rate else ""


def _number(cell: str) -> Markup:
    """Return a number as HTML, with its interval or standard deviation smaller."""
    return Markup(_BRACKETS.sub(r" <small>\1</small>", str(inline(cell))))
