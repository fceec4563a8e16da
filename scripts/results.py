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
from lemma.evaluation.experiments.catalog import SUITES
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    PolicyResults,
    entries_of,
    read_results,
    shown,
    shown_mean,
)
from lemma.evaluation.report.rung_table import command_table, rung_table
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
from lemma.evaluation.report.tables import at_a_glance, cause_shares
from lemma.tasks.suite import SUITE
from lemma.viz.pages.report_figures import headline_figure, stages_figure
from lemma.viz.plots import Figure, standalone
from trainings import (
    Training,
    read_trainings,
    seconds_by_name,
    training_table,
    undrawn,
    validation_figure,
)

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
COMMANDS = "Control level, commands"
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

{names}

## Which task is hard for whom

High-level instructions, strict.

{tasks}{rungs}
## Why episodes fail

All kinds of instructions and all seeds; strict.
[](evaluation.md#why-an-episode-failed) defines the causes. – stands where a cause
cannot be told, because no sub-task names objects: missed grasps, for instance, are then
among the mistakes that count as *wrong object*.

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

{caption}
"""
_CAPTION = (
    "*The score by which the best weights of a training are chosen, at its "
    "validations; each model has its own. Lines of one color are the seeds of one "
    "model.{undrawn} "
    "[](results/rows.md#trainings) lists all trainings.*"
)

_RUNGS = """
## Rungs of the ladder

Motor commands or waypoints from one sentence and camera images, but for the expert,
which sees the truth; high-level instructions, strict. KeyPose is one policy for all
rungs, ACT and Diffusion Policy are one for each of three.
[](results/controls.md#control-level) has other instructions and how far episodes came,
[](results/controls.md#control-level-commands) the commands that train and evaluate.

{rungs}"""

_NAMES = """\
- ET: [Episodic Transformer]({0}policies.md#episodic-transformer), which plans one \
sub-task from each new image (*single-step*), or all from the first (*multi-step*).
- [CLIPort]({0}policies.md#cliport-and-m-cliport) finds the poses of a sub-task, \
M-CLIPort whole decisions. [ReachNet]({0}policies.md#reachnet) learns the reach of \
arms from labels of the simulator, or from demonstrations alone.
- GTA, ground-truth allocation: an oracle names the robot of each sub-task, \
[not the policy]({0}evaluation.md#inputs-of-an-episode).
- *High-level*, *human*, *unseen* and *blind* are \
[kinds of sentences]({0}language.md#four-kinds-of-instructions), the last two for \
evaluation alone.
"""
"""Lines that explain the names in the first table; with the folder of the pages."""


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
        "The last column is the score at the end less that after four fifths, "
        "interpolated between validations. A small one does not prove that a training "
        "was long enough: the learning rate falls to zero along a cosine, which "
        "flattens every curve. A training that a time ended cannot be repeated "
        "exactly. Frames per second are those of a machine that did other work beside "
        "it.",
        training_table(trainings),
        ROWS,
    )
    commands = Section(
        COMMANDS,
        "`SEED` is 0, 1 or 2. Seconds of training are those of the "
        "[records](rows.md#trainings). The published weights of KeyPose had the "
        "further option `--time-limit-s 610`. With seed 0, ACT and Diffusion Policy "
        "had a time limit, not `--steps`, and did as many steps; up to three of their "
        "trainings shared a GPU.",
        command_table(every, seconds_by_name(trainings)),
        CONTROLS,
    )
    listed = [*sections(every, "[](../evaluation.md)"), commands, curves, trained]
    found = [section for section in listed if section.table.rows]
    played = _headliners(every)
    written = {PAGE: _front(every, played, found, trainings)}
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
    trainings: Sequence[Training],
) -> str:
    rungs = rung_table(every)
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
        names=_NAMES.format("").rstrip(),
        tasks=_by_task(played).markdown(),
        rungs=_RUNGS.format(rungs=rungs.markdown()) if rungs.rows else "",
        causes=cause_shares(played).markdown(),
        training=_training(trainings) if trainings else "",
        links="\n".join(links) + "\n",
        toctree="\n".join(f"results/{topic}" for topic in TOPICS),
    )


def _training(trainings: Sequence[Training]) -> str:
    caption = _CAPTION.format(undrawn=undrawn(trainings))
    return _TRAINING.format(caption=_wrapped(caption))


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
    """Return the policies of the main tables: rows of the paper and of ReachNet."""
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


def headline(results: Path = RESULTS) -> str:
    """Return the README's text about results: rows of the paper and of ReachNet."""
    played = _headliners(entries(results))
    if not played:
        return NOTHING
    words = protocol_words(played, f"[{HOW}](docs/results/rows.md)")
    table = at_a_glance(played).markdown()
    about = f"{words} {sample_words(played)}".strip()
    return f"{about}\n\n{table}\n{_NAMES.format('docs/')}"


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
