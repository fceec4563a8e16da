"""Write the pages and tables of results, and the table in README.md, from results/.

Run from the repository: ``python scripts/results.py``. It writes docs/results.md with
its figure, a page for each topic and a CSV file for each table in docs/results/.
Without results, the page and the README state that there are none.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill

from learning_curves import learning_curves, read_curves
from lemma.core.tables import Table
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.experiments.catalog import SUITES
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    PolicyResults,
    entries_of,
    read_results,
    shown,
    shown_mean,
)
from lemma.evaluation.report.sections import (
    CONTROLS,
    HOW,
    ROWS,
    TOPICS,
    Section,
    protocol_words,
    sample_words,
    sections,
)
from lemma.evaluation.report.tables import at_a_glance, words
from lemma.tasks.suite import SUITE
from lemma.viz.pages.report_figures import headline_figure, stages_figure
from lemma.viz.plots import Figure, standalone
from trainings import read_trainings, training_table, validation_figure

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
DOCS = ROOT / "docs"
PAGE = DOCS / "results.md"
FOLDER = DOCS / "results"
IMAGES = DOCS / "images"
FIGURE = IMAGES / "results.svg"
STAGES = IMAGES / "stages.svg"
CURVES = IMAGES / "validation.svg"
FIGURES = (FIGURE, STAGES, CURVES)
README = ROOT / "README.md"
BEGIN, END = "<!-- results -->\n", "<!-- /results -->\n"
NOTHING = (
    "There are no results of this version yet. `lemma reproduce all` makes them from "
    "weights\nthat ship, `lemma reproduce all --print` says how those are trained.\n"
)
TITLES = dict(
    zip(
        TOPICS,
        (
            "Success in all tables",
            "Controls, control level, ablations",
            "Why episodes fail",
            "How each row is made",
        ),
        strict=True,
    )
)
BY_TASK = ": losses by task"
LONG = ("Distractors", "Robot types", "Stages", "Where the points are lost")
"""Tables that begin so, or end with :data:`BY_TASK`, are too long for a page."""
_PAGE = """\
# Results

{protocol} {sample}

![Success by task, high-level instructions](images/results.svg)

*High-level instructions, strict: the first sub-task that the chosen robot cannot do
ends the episode. Whiskers: 95 % intervals of one training seed, else one standard
deviation over the seeds. Strokes: the figures of the paper, on another simulator.*

## Mean over the tasks

{glance}
With one training seed: the rate and its 95 % Wilson interval over the episodes. With
several: mean ± standard deviation over the seeds. *Lenient*: the same episodes, where
the policy is told that a robot cannot do a sub-task, and goes on. *Paper*: as printed
there, on Isaac Sim with its own scenes and sentences, so the same row is the same kind
of policy and not the same experiment. [](evaluation.md) says what a number is.

## Which task is hard for whom

High-level instructions, strict.

{tasks}
## Why episodes fail

All kinds of instructions and all seeds; strict.
[](evaluation.md#why-an-episode-failed) defines the causes.

{causes}
![Furthest stage, high-level instructions](images/stages.svg)

*High-level instructions, strict: episodes by the furthest stage of the expert's plan
that they reached, in its first sub-task or in a later one. Right: the success rate.*
{training}
## All tables

{links}
```{{toctree}}
:hidden:

{toctree}
```

This page is written by `python scripts/results.py` from the files in `results/` and
from nothing else. `lemma reproduce NAME` makes a row.
"""

_TRAINING = """
## How the weights were trained

![Validation while training](images/validation.svg)

*The score by which the best weights of a training are chosen, at its validations; each
model has its own. [](results/rows.md#trainings) lists all trainings.*
"""


def entries(results: Path = RESULTS) -> list[PolicyResults]:
    """Return the results in a folder by policy, including rows without results."""
    found = read_results([results]) if results.exists() else []
    return entries_of(found, complete=True)


def pages(results: Path = RESULTS) -> dict[Path, str]:
    """Return the contents of all written files below docs, by path."""
    every = entries(results)
    curves = Section(
        "Learning curves",
        "Of the policies at control level: checkpoints on episodes of split `val`, "
        "strict.",
        learning_curves(read_curves(results)),
        CONTROLS,
    )
    trainings = read_trainings(results / "trainings")
    trained = Section(
        "Trainings",
        "The last column is near zero where a training had long enough. Frames per "
        "second are those of a machine that did other work beside it.",
        training_table(trainings),
        ROWS,
    )
    listed = [*sections(every, "[](../evaluation.md)"), curves, trained]
    found = [section for section in listed if section.table.rows]
    played = _headliners(every)
    written = {PAGE: _front(every, played, found, curved=bool(trainings))}
    for topic in TOPICS:
        of_topic = [section for section in found if section.topic == topic]
        written[FOLDER / f"{topic}.md"] = _topic_page(topic, of_topic)
    for section in found:
        written[FOLDER / f"{section.name}.csv"] = section.table.csv()
    if played:
        written[FIGURE] = _on_white(headline_figure(played))
    staged = stages_figure(played)
    if staged:
        written[STAGES] = _on_white(staged)
    if trainings:
        written[CURVES] = _on_white(validation_figure(trainings))
    return written


def _on_white(figure: Figure) -> str:
    """Return a figure's SVG with a white background, for pages in dark mode."""
    begin, end, rest = standalone(figure.svg).partition(">")
    white = '<rect width="100%" height="100%" fill="#ffffff"/>'
    return f"{begin}{end}{white}{rest}"


def _front(
    every: Sequence[PolicyResults],
    played: Sequence[PolicyResults],
    found: Sequence[Section],
    *,
    curved: bool,
) -> str:
    links = [
        f"- [](results/{topic}.md): "
        + "; ".join(
            f"{section.title} ([CSV](results/{section.name}.csv))"
            for section in found
            if section.topic == topic
        )
        for topic in TOPICS
    ]
    return _PAGE.format(
        protocol=protocol_words(every, f"[{HOW}](results/rows.md)"),
        sample=sample_words(played),
        glance=at_a_glance(played).markdown() if played else NOTHING,
        tasks=_by_task(played).markdown(),
        causes=_causes(played).markdown(),
        training=_TRAINING if curved else "",
        links="\n".join(links) + "\n",
        toctree="\n".join(f"results/{topic}" for topic in TOPICS),
    )


def _topic_page(topic: str, found: Sequence[Section]) -> str:
    text = f"# {TITLES[topic]}\n\n[](../results.md) says how to read these tables.\n"
    samples = {section.sample for section in found}
    if len(samples) == 1 and any(samples):
        text += f"{samples.pop()}\n"
    long = [one for one in found if one.title.startswith(LONG)]
    long += [one for one in found if one.title.endswith(BY_TASK)]
    empty = []
    for section in found:
        if section in long:
            continue
        played, missing = _played(section.table)
        if not played.rows:
            empty.append(section)
            continue
        note = section.note if len(samples) < 2 else section.caption
        body = [_wrapped(note), played.markdown()]
        if section.title == HOW and missing:
            body.insert(
                1, _wrapped(f"Rows that are {NOT_RUN} yet: {', '.join(missing)}.")
            )
        text += f"\n## {section.title}\n\n" + "\n\n".join(filter(None, body))
    for title, listed in (("Long tables, as CSV", long), ("Not run yet", empty)):
        if listed:
            text += f"\n## {title}\n\n"
        for section in listed:
            link = f"- [{section.title}]({section.name}.csv)"
            note = "" if section.title.endswith(BY_TASK) else section.note
            text += _wrapped(f"{link}: {note}" if note else link, "  ") + "\n"
    return text


def _wrapped(text: str, indent: str = "") -> str:
    # Code stays in one line.
    held = re.sub("`[^`]+`", lambda match: match[0].replace(" ", "\0"), text)
    lines = fill(
        held,
        88,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines.replace("\0", " ")


def _played(table: Table) -> tuple[Table, list[str]]:
    """Return a table without rows that were not run, and their second cells.

    Figures of the paper stay, under the name of the row that they belong to.
    """
    rows, missing, skipped = [], [], ""
    for row in table.rows:
        if NOT_RUN in row:
            skipped = row[0]
            missing.append(row[1].replace("lemma reproduce ", ""))
        elif row[0] == "*paper*" and skipped:
            rows.append((f"{skipped}, *paper*", *row[1:]))
        else:
            skipped = ""
            rows.append(row)
    return replace(table, rows=tuple(rows)), missing


def _headliners(every: Sequence[PolicyResults]) -> list[PolicyResults]:
    """Return the policies of the main tables: rows of the paper, and ours."""
    return [
        entry for entry in every if entry.results and entry.suite in ("", *SUITES[:2])
    ]


def _by_task(played: Sequence[PolicyResults]) -> Table:
    rows = [
        (
            entry.title,
            *(shown(entry.select("high_level", task=task)) for task in SUITE),
            shown_mean(entry.select("high_level")),
        )
        for entry in played
    ]
    return Table(("success [%]", *SUITE, "mean"), tuple(rows))


def _causes(played: Sequence[PolicyResults]) -> Table:
    rows = []
    for entry in played:
        counted, total = entry.causes(), entry.episodes()
        shares = [f"{100 * counted[cause] / total:.1f}" for cause in Cause]
        rows.append((entry.title, f"{100 * counted.total() / total:.1f}", *shares))
    used = [
        number
        for number in range(2 + len(Cause))
        if number < 2 or any(row[number] != "0.0" for row in rows)
    ]
    header = ("share of episodes [%]", "failed", *(words(cause) for cause in Cause))
    return Table(
        tuple(header[number] for number in used),
        tuple(tuple(row[number] for number in used) for row in rows),
    )


def headline(results: Path = RESULTS) -> str:
    """Return the README's text about results: rows of the paper, and ours."""
    played = _headliners(entries(results))
    if not played:
        return NOTHING
    words = protocol_words(played, f"[{HOW}](docs/results/rows.md)")
    table = at_a_glance(played).markdown()
    return f"{f'{words} {sample_words(played)}'.strip()}\n\n{table}"


def readme(results: Path = RESULTS) -> str:
    """Return the README with the present table."""
    before, found, rest = README.read_text(encoding="utf-8").partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (found and ended):
        raise SystemExit(f"{README} has no lines {BEGIN.strip()} and {END.strip()}.")
    return f"{before}{BEGIN}{headline(results)}{END}{after}"


def main() -> None:
    """Write all files, and remove outdated tables."""
    FOLDER.mkdir(exist_ok=True)
    written = pages()
    for old in {*FOLDER.glob("*.csv"), *FOLDER.glob("*.md")} - set(written):
        old.unlink()
    for path, text in written.items():
        path.write_text(text, encoding="utf-8")
    README.write_text(readme(), encoding="utf-8")


if __name__ == "__main__":
    main()
