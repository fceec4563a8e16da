"""The report of results: its sections, and the page in Markdown.

The numbers come from results alone; the text is in ``page.md``.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files

from lemma.core.tables import Table
from lemma.evaluation.analysis.result import Result
from lemma.evaluation.experiments.catalog import (
    ABLATION_EPISODES,
    CONTROL_LEVEL,
    EXPERIMENTS,
    SEEDS,
    SUITES,
)
from lemma.evaluation.records import older_versions
from lemma.evaluation.report import measures, pair_table, tables, team_table
from lemma.evaluation.report.below_paper import below_paper
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    PARTIAL,
    PolicyResults,
    tasks_of,
)
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.language.template import ALL_KINDS, EVALUATION_KINDS
from lemma.tasks.suite import SUITE

REPORT = "results.md"
SUCCESS, CONTROLS, DIAGNOSES, ROWS = TOPICS = (
    "success",
    "controls",
    "diagnoses",
    "rows",
)
"""Success as in the paper and with other sentences; controls, control level and
ablations; causes of failure; how rows are made."""
CONTROL = "Control level"
RUNGS = "Control level, by stages"
LOST = "Control level, causes of failure"
"""Titles of the tables of policies at control level."""
PAIRS = "Pairs of which one cannot be done"
"""Title of the table of refusals, which stands alone."""
HOW = "How each row is made"
"""Title of the table with command, weights and number of episodes of each result."""
_LIMITED = " (a time limit ended the training: nobody can repeat it)"


@dataclass(frozen=True, slots=True)
class Section:
    """One table of the report with its caption."""

    title: str
    note: str
    """Text of the caption in Markdown; may be empty."""
    table: Table
    topic: str
    """Topic of the section, one of :data:`TOPICS`."""
    sample: str = ""
    """Number of episodes, if not all, in Markdown."""

    @property
    def caption(self) -> str:
        """The note and the number of episodes."""
        return f"{self.note} {self.sample}".strip()

    @property
    def name(self) -> str:
        """Name for links and files: lower case, words joined by dashes."""
        kept = (c if c.isalnum() else " " for c in self.title.lower())
        return "-".join("".join(kept).split())


def page(
    entries: Sequence[PolicyResults],
    source: str = "the files named below",
    guide: str = "docs/evaluation.md",
) -> str:
    """Return the page in Markdown.

    Args:
        entries: Results to report.
        source: Description of the source of the results.
        guide: Link to the page about evaluation.
    """
    introduction, _ = _prose(guide)
    text = introduction.format(source=source, protocol=protocol_words(entries))
    return text + "".join(
        _written(section) for section in sections(entries, guide) if section.table.rows
    )


def _prose(guide: str) -> tuple[str, dict[str, str]]:
    """Return the introduction of the page, and the notes by title of the table."""
    text = (files("lemma.evaluation.report") / "page.md").read_text("utf-8")
    for name, value in (
        ("guide", guide),
        ("not_run", NOT_RUN),
        ("ablation_episodes", str(ABLATION_EPISODES)),
        ("seeds", ", ".join(map(str, SEEDS))),
    ):
        text = text.replace(f"{{{name}}}", value)
    introduction, *parts = text.split("\n## ")
    notes = (part.partition("\n") for part in parts)
    return introduction, {title: " ".join(note.split()) for title, _, note in notes}


def sections(
    entries: Sequence[PolicyResults], guide: str = "docs/evaluation.md"
) -> list[Section]:
    """Return all tables, in the order of the report.

    Args:
        entries: Results to report.
        guide: Link to the page about evaluation.
    """
    _, notes = _prose(guide)
    if any(result.pairs for entry in entries for result in entry.results):
        return [
            Section(PAIRS, notes[PAIRS], _of_pairs(entries), SUCCESS),
            Section(HOW, "", _provenance(entries), ROWS),
        ]
    sample = sample_words([one for one in entries if one.suite != CONTROL_LEVEL])
    samples = {
        CONTROL: sample_words([one for one in entries if one.suite == CONTROL_LEVEL]),
        RUNGS: "",
        LOST: "",
        HOW: "",
    }
    return [
        Section(title, notes.get(title, ""), table, topic, samples.get(title, sample))
        for topic, listed in (
            (SUCCESS, _of_success(entries)),
            (CONTROLS, _of_controls(entries)),
            (DIAGNOSES, _of_diagnoses(entries)),
            (ROWS, {HOW: _provenance(entries)}),
        )
        for title, table in listed.items()
    ]


def _of_success(entries: Sequence[PolicyResults]) -> dict[str, Table]:
    """Return tables of success as in the paper, and with further instructions."""
    return {
        "High-level instructions": tables.by_task(entries, "high_level"),
        "Human instructions": tables.by_task(entries, "human"),
        "Distractors, as in the paper": tables.distractors_by_task(entries),
        **{
            f"{title}, {tables.words(kind, '-')} instructions": tables.breakdown(
                entries, kind, by
            )
            for kind in ("high_level", "human")
            for title, by in (("Distractors", "distractors"), ("Robot types", "team"))
        },
        "Unseen templates": tables.by_task(entries, "unseen"),
        "Blind templates": tables.by_task(entries, "blind"),
        "Relational instructions": tables.by_task(entries, "relational"),
    }


def _of_pairs(entries: Sequence[PolicyResults]) -> Table:
    """Return how often policies act where a team can, and refuse where it cannot."""
    return pair_table.pair_table(
        (f"{entry.title}, {tables.words(one.kind, '-')}", one)
        for entry in entries
        for result in entry.results
        for one in result.pairs
    )


def _of_controls(entries: Sequence[PolicyResults]) -> dict[str, Table]:
    """Return tables of controls, control level and ablations."""
    rungs = [one for one in entries if one.suite == CONTROL_LEVEL]
    return {
        "Other sentences": tables.language(entries),
        CONTROL: tables.control_level(entries),
        RUNGS: measures.reached(rungs, by_task=True),
        LOST: tables.losses(rungs),
        "Perturbed starts": tables.starts(entries),
        "Ablations": tables.ablations(entries),
    }


def _of_diagnoses(entries: Sequence[PolicyResults]) -> dict[str, Table]:
    """Return tables of causes of failure, coordination and use of time."""
    # Those at control level have other tasks.
    entries = [one for one in entries if one.suite != CONTROL_LEVEL]
    return {
        "Stages": measures.reached(entries),
        "Where the points are lost": tables.losses(entries),
        "Below the paper": below_paper(entries),
        **{
            f"{entry.title}: losses by task": tables.losses_by_task(entry)
            for entry in entries
            # Only rows of the paper and of ReachNet, and what is no experiment.
            if entry.suite in ("", *SUITES[:2]) and entry.causes()
        },
        "How exact the poses are": tables.precision(entries, "high_level"),
        "Coordination": measures.coordination(entries, "high_level"),
        **{
            f"{entry.title}: {name}{seed}": table
            for entry in entries
            for result in entry.results
            for seed in [f", seed {result.seed}" if entry.results[1:] else ""]
            for name, table in team_table.team_tables(result.teams).items()
        },
    }


def _written(section: Section) -> str:
    body = "\n\n".join(filter(None, (section.caption, section.table.markdown())))
    return f"\n## {section.title}\n\n{body}"


def protocol_words(entries: Sequence[PolicyResults], where: str = f"*{HOW}*") -> str:
    """Return one or two sentences about the evaluated episodes, or the part of them.

    Args:
        entries: Results by policy.
        where: Name of the table with the number of episodes of each result.
    """
    # Those at control level have tasks of their own, and a table that names them.
    listed = [one for one in entries if one.suite != CONTROL_LEVEL and one.results]
    results = [result for entry in listed or entries for result in entry.results]
    about = results[0].about if results else {}
    split = about.get("split", "test")
    benchmark = about.get("benchmark", BENCHMARK_VERSION)
    text = f"Split `{split}` of benchmark `{benchmark}`: "
    counts = [count for result in results for count in result.extents.values()]
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
    if any({task for _, task in one.extents} != set(SUITE) for one in results):
        text += f". {PARTIAL} marks a mean over other tasks than the suite's eight"
    return f"{text}.{_older_words(results, benchmark)}"


def _older_words(results: Iterable[Result], benchmark: str) -> str:
    """Return a sentence about weights of another version; usually empty."""
    older = {
        version
        for result in results
        for version in older_versions(result.about["weights"], benchmark)
    }
    if not older:
        return ""
    names = " and ".join(f"`{name}`" for name in sorted(older))
    return f" **Weights were trained on {names}** of the benchmark, and play on."


def sample_words(entries: Sequence[PolicyResults]) -> str:
    """Return a sentence for captions if episodes are missing; usually empty."""
    parts = [r for entry in entries for r in entry.results if not _is_whole(r)]
    if not parts:
        return ""
    counts = [count for result in parts for count in result.extents.values()]
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
        for kind in (ALL_KINDS if found else EVALUATION_KINDS)
        if kind in found or not found
    ]
    return " and ".join([", ".join(kinds[:-1]), kinds[-1]] if kinds[1:] else kinds)


def _wanted(result: Result) -> tuple[str, ...]:
    """Return the tasks of a complete result."""
    name = result.experiment
    return EXPERIMENTS[name].tasks if name in EXPERIMENTS else SUITE


def _is_whole(result: Result) -> bool:
    """Return whether a result has all episodes of all its tasks."""
    found = result.extents
    every = SPLITS.get(result.about["split"])
    kinds = {kind for kind, _ in found}
    # A sampled split has no fixed number of episodes.
    return every is not None and all(
        found.get((kind, task)) == every for kind in kinds for task in _wanted(result)
    )


def _extent(result: Result) -> str:
    """Return the number of episodes of a result, and the full number if it is less."""
    found = result.extents
    episodes = sum(found.values())
    split = result.about["split"]
    if _is_whole(result) or split not in SPLITS:
        return str(episodes)
    kinds = {kind for kind, _ in found}
    return f"{episodes} of {len(kinds) * len(_wanted(result)) * SPLITS[split]}"


def _provenance(entries: Iterable[PolicyResults]) -> Table:
    """Return the table of commands and weights of each result."""
    rows: list[tuple[str, ...]] = []
    for entry in entries:
        if not entry.results and entry.experiment is not None:
            command = f"`lemma reproduce {entry.experiment.name}`"
            rows.append((entry.title, command, NOT_RUN, "", ""))
        for result in entry.results:
            hashes = ", ".join(
                f"{name} `{file['sha256'][:12]}`{_LIMITED if 'ended' in file else ''}"
                for name, file in result.about["weights"].items()
            )
            seed = str(result.seed) if hashes else "none"
            rows.append(
                (entry.title, f"`{result.command}`", hashes, seed, _extent(result))
            )
    header = ("row", "command", "SHA-256 of the weights", "training seed", "episodes")
    return Table(header, tuple(rows), labels=3)
