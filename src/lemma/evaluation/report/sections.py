"""The report of results: its sections, and the page in Markdown.

Made from results and from nothing else.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from lemma.core.tables import Table
from lemma.evaluation.analysis.result import Result
from lemma.evaluation.experiments.catalog import (
    ABLATION_EPISODES,
    CONTROL_LEVEL,
    EXPERIMENTS,
    SEEDS,
    SUITES,
)
from lemma.evaluation.report import tables
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    PARTIAL,
    LearningCurve,
    PolicyResults,
    tasks_of,
)
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE

REPORT = "results.md"
NONE: Mapping[str, LearningCurve] = {}
SUCCESS, CONTROLS, DIAGNOSES, ROWS = TOPICS = (
    "success",
    "controls",
    "diagnoses",
    "rows",
)
"""Success as in the paper and with other sentences; controls, control level and
ablations; causes of failure; how rows are made."""
CONTROL = "Control level"
"""Title of the table of policies that answer motor commands."""
_LIMITED = " (a time limit ended the training: nobody can repeat it)"
_INTRODUCTION = """\
# Results

Success rates of policies on the frozen lists, skills executed in the simulator. This
page is written by a command, from {source} and from nothing else.

- **What a number is.** {protocol}
  An episode counts if its goal holds at the end. {guide} says what else fixes a number.
- **Strict and lenient.** The headline is strict: the first sub-task that the chosen
  robot cannot do ends the episode, as a protective stop ends what a real arm does. The
  row *lenient* below it is of the same episodes, played on: the policy is told, and the
  attempt costs five simulated seconds. Diagnoses are of the strict episodes.
- **Intervals.** With one training seed: the rate and its 95 % Wilson interval over the
  episodes. With several: mean ± standard deviation over the seeds. The simulator is
  deterministic, so a second run of the same weights gives the same episodes.
- **The paper's figures** are as printed there, mean ± standard deviation over ten runs
  of the same weights on Isaac Sim, with its own scenes and sentences; ours are from
  MuJoCo. Simulators differ: the same row is the same kind of policy, not the same
  experiment.
- *{not_run}* says that there are no results yet: the weights do not ship, or nobody has
  evaluated them.

`lemma reproduce NAME` makes a row, with the names that stand at the end; with `--print`
it prints how the weights are trained.
"""


@dataclass(frozen=True, slots=True)
class Section:
    """One table of the report, and what to say of it."""

    title: str
    note: str
    """In Markdown; may be empty."""
    table: Table
    topic: str
    """Topic of the section, one of :data:`TOPICS`."""
    sample: str = ""
    """Number of episodes that it counts, if not all; in Markdown."""

    @property
    def caption(self) -> str:
        """The note, and of how many episodes the table is."""
        return f"{self.note} {self.sample}".strip()

    @property
    def name(self) -> str:
        """A name for links and files: lower case, words joined by dashes."""
        kept = (c if c.isalnum() else " " for c in self.title.lower())
        return "-".join("".join(kept).split())


def page(
    entries: Sequence[PolicyResults],
    source: str = "the files named below",
    guide: str = "docs/evaluation.md",
    curves: Mapping[str, LearningCurve] = NONE,
) -> str:
    """Return the page.

    Args:
        entries: Results to report.
        source: Where the results are from, as the page says it.
        guide: The page about evaluation, as the page names it.
        curves: By experiment.
    """
    text = _INTRODUCTION.format(
        source=source,
        guide=guide,
        protocol=protocol_words(entries),
        not_run=NOT_RUN,
    )
    return text + "".join(
        _written(section)
        for section in sections(entries, guide, curves)
        if section.table.rows
    )


def sections(
    entries: Sequence[PolicyResults],
    guide: str = "docs/evaluation.md",
    curves: Mapping[str, LearningCurve] = NONE,
) -> list[Section]:
    """Return all tables, in the order of the report.

    Args:
        entries: Results to report.
        guide: The page about evaluation, as notes name it.
        curves: By experiment.
    """
    sample = sample_words([one for one in entries if one.suite != CONTROL_LEVEL])
    control = sample_words([one for one in entries if one.suite == CONTROL_LEVEL])
    curve = Section(
        "Learning curves",
        "Of the policies at control level: checkpoints on episodes of split `val`, "
        "strict.",
        tables.learning_curves(curves),
        CONTROLS,
    )
    found = [
        Section(title, note, table, topic, control if title == CONTROL else sample)
        for topic, listed in (
            (SUCCESS, _of_success(entries)),
            (CONTROLS, _of_controls(entries, guide)),
            (DIAGNOSES, _of_diagnoses(entries, guide)),
        )
        for title, note, table in listed
    ]
    return [*found, curve, _provenance(entries)]


Told = list[tuple[str, str, Table]]
"""Title, note and table of sections."""


def _of_success(entries: Sequence[PolicyResults]) -> Told:
    found = [
        (
            "High-level instructions",
            "As in the paper.",
            tables.by_task(entries, "high_level"),
        ),
        (
            "Human instructions",
            "As in the paper. Templates of this kind are seen in training; ours "
            "are not crowd-sourced.",
            tables.by_task(entries, "human"),
        ),
        (
            "Distractors, as in the paper",
            "By number of objects that the goal does not need, in four tasks.",
            tables.distractors_by_task(entries),
        ),
    ]
    for kind in ("high_level", "human"):
        name = f"{tables.words(kind, '-')} instructions"
        mixed = (
            "All tasks together. They have different ranges of it, so the columns hold "
            "different mixtures of tasks."
        )
        distractors = tables.breakdown(entries, kind, "distractors")
        teams = tables.breakdown(entries, kind, "team")
        found += [
            (f"Distractors, {name}", mixed, distractors),
            (f"Robot types, {name}", "As in the paper: by team.", teams),
        ]
    return [
        *found,
        (
            "Unseen templates",
            "Sentences of templates that training never sees; not in the paper.",
            tables.by_task(entries, "unseen"),
        ),
        (
            "Blind templates",
            "Sentences of somebody who had read none of this project's templates, "
            "rules or results, and which no part of a policy was made with; not in the "
            "paper.",
            tables.by_task(entries, "blind"),
        ),
    ]


def _of_controls(entries: Sequence[PolicyResults], guide: str) -> Told:
    return [
        (
            "Other sentences",
            "How much a policy needs the sentence: success at the goal of the instance "
            "when something else is said, or nothing; strict. Without distractors "
            "there is little to guess. Last: how often what swapped colors ask for "
            "holds.",
            tables.language(entries),
        ),
        (
            CONTROL,
            "ACT and Diffusion Policy of LeRobot, which answer where each gripper "
            "shall go five times a second; one policy for these tasks. *Told poses and "
            "goal* is an oracle: it sees no pictures and reads no sentence. `lemma "
            "reproduce control-level --print` says how they are trained.",
            tables.control_level(entries),
        ),
        (
            "Perturbed starts",
            f"Objects begin a little elsewhere; strict. {guide} says how.",
            tables.starts(entries),
        ),
        (
            "Ablations",
            "One thing left out of ReachNet's training each, and two controls; all are "
            f"trained alike long, on {ABLATION_EPISODES} demonstrations of each task, "
            f"with seed 0; strict. {guide} lists them.",
            tables.ablations(entries),
        ),
    ]


def _of_diagnoses(entries: Sequence[PolicyResults], guide: str) -> Told:
    return [
        (
            "Where the points are lost",
            "Failed episodes by cause, over all seeds. The expert is asked before "
            "every sub-task what it would do in the same state; "
            f"{guide} defines the causes.",
            tables.losses(entries),
        ),
        *(
            (f"{entry.title}: losses by task", "", tables.losses_by_task(entry))
            for entry in entries
            # A page has room for the rows of the paper, ours, and anybody's own.
            if entry.suite in ("", *SUITES[:2]) and entry.causes()
        ),
        (
            "How exact the poses are",
            "High-level instructions; distance from the middle of the cube, or of the "
            "pad or cube below, where the sub-task was the expert's. In brackets the "
            "part that is more than 20 mm off. Places in the shared region and poses "
            "of the stick are a matter of choice, so they are not here.",
            tables.precision(entries, "high_level"),
        ),
        (
            "Coordination",
            "High-level instructions. Time against the expert's where both succeed, "
            "the part of it in which each robot is idle, sub-tasks given at the first "
            "try to a robot that is able to do them, and to the expert's, those that "
            "came too soon, and how near the arms came to each other; "
            f"{guide} defines them.",
            tables.coordination(entries, "high_level"),
        ),
    ]


def _written(section: Section) -> str:
    body = "\n\n".join(filter(None, (section.caption, section.table.markdown())))
    return f"\n## {section.title}\n\n{body}"


HOW = "How each row is made"
"""Title of the table that says of how many episodes each result is."""


def protocol_words(entries: Sequence[PolicyResults], where: str = f"*{HOW}*") -> str:
    """Return what was played, in a sentence or two; a part is called a part.

    Args:
        entries: By whom.
        where: How the table that says of how many episodes each result is, is named.
    """
    results = [result for entry in entries for result in entry.results]
    about = results[0].about if results else {}
    split = about.get("split", "test")
    benchmark = about.get("benchmark", BENCHMARK_VERSION)
    text = f"Split `{split}` of benchmark `{benchmark}`: "
    counts = [count for result in results for count in _extents(result).values()]
    whole = not results or any(_is_whole(result) for result in results)
    if whole:
        text += f"{SPLITS[split]} episodes of each of the eight tasks"
    else:
        text += f"**in part**, {_part_words(tasks_of(entries), counts, split)}"
    text += f", with {_kind_words(results)} instructions"
    if about:
        text += (
            f"; {about['horizon_s']:.0f} simulated seconds; MuJoCo {about['mujoco']}"
        )
    if whole and not all(_is_whole(result) for result in results):
        text += (
            f". Some rows, or some of their seeds, are of fewer: the table {where} "
            "says of how many"
        )
    if any({task for _, task in _extents(one)} != set(SUITE) for one in results):
        text += f". {PARTIAL} marks a mean over other tasks than the suite's eight"
    return f"{text}."


def sample_words(entries: Sequence[PolicyResults]) -> str:
    """Return what captions say where not all episodes were played; mostly nothing."""
    parts = [r for entry in entries for r in entry.results if not _is_whole(r)]
    if not parts:
        return ""
    counts = [count for result in parts for count in _extents(result).values()]
    words = _part_words(tasks_of(entries), counts, parts[0].about["split"])
    some = any(_is_whole(result) for entry in entries for result in entry.results)
    return f"**{'Some rows are of a sample' if some else 'A sample'}:** {words}."


def _part_words(tasks: Sequence[str], counts: Sequence[int], split: str) -> str:
    least, most = min(counts), max(counts)
    number = f"{most}" if least == most else f"{least} to {most}"
    if split in SPLITS:
        number += f" of {SPLITS[split]}"
    names = ", ".join(tasks)
    if len(tasks) == 1:
        return f"{number} episodes of {names}"
    if set(tasks) == set(SUITE):
        return f"{number} episodes of each of the eight tasks"
    of = "" if set(tasks) - set(SUITE) else " of the eight"
    return f"{number} episodes of each of {len(tasks)}{of} tasks ({names})"


def _kind_words(results: Iterable[Result]) -> str:
    found = {cell.kind for result in results for cell in result.cells}
    kinds = [
        tables.words(kind, "-")
        for kind in EVALUATION_KINDS
        if kind in found or not found
    ]
    return " and ".join([", ".join(kinds[:-1]), kinds[-1]] if kinds[1:] else kinds)


def _extents(result: Result) -> dict[tuple[str, str], int]:
    """Return the episodes of a result by kind and task."""
    counted: Counter[tuple[str, str]] = Counter()
    for cell in result.cells:
        counted[cell.kind, cell.task] += cell.episodes
    return dict(counted)


def _wanted(result: Result) -> tuple[str, ...]:
    """Return the tasks that a result should be of."""
    name = result.experiment
    return EXPERIMENTS[name].tasks if name in EXPERIMENTS else SUITE


def _is_whole(result: Result) -> bool:
    """Whether all episodes of all tasks that it should be of were played."""
    found = _extents(result)
    every = SPLITS.get(result.about["split"])
    kinds = {kind for kind, _ in found}
    # A split that is sampled has no end.
    return every is not None and all(
        found.get((kind, task)) == every for kind in kinds for task in _wanted(result)
    )


def _extent(result: Result) -> str:
    """Return of how many episodes a result is, and whether there should be more."""
    found = _extents(result)
    episodes = sum(found.values())
    split = result.about["split"]
    if _is_whole(result) or split not in SPLITS:
        return str(episodes)
    kinds = {kind for kind, _ in found}
    return f"{episodes} of {len(kinds) * len(_wanted(result)) * SPLITS[split]}"


def _provenance(entries: Iterable[PolicyResults]) -> Section:
    """Return how each result is made, and of which weights."""
    rows: list[tuple[str, ...]] = []
    for entry in entries:
        if not entry.results and entry.experiment is not None:
            command = f"`lemma reproduce {entry.experiment.name}`"
            rows.append((entry.title, command, NOT_RUN, "", ""))
        for result in entry.results:
            hashes = ", ".join(
                f"{name} `{told['sha256'][:12]}`{_LIMITED * bool(told.get('ended'))}"
                for name, told in result.about["weights"].items()
            )
            seed = str(result.seed) if hashes else "none"
            rows.append(
                (entry.title, f"`{result.command}`", hashes, seed, _extent(result))
            )
    header = ("row", "command", "SHA-256 of the weights", "training seed", "episodes")
    return Section(
        HOW,
        f"Reported models are trained with seeds {', '.join(map(str, SEEDS))}; "
        "the weights of the first ship.",
        Table(header, tuple(rows), labels=3),
        ROWS,
    )
