"""`lemma evaluate`: a policy on a frozen split, with a table of success rates."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from lemma.cli.options import Flag, JsonFlag, Number, Word, complain, output, print_json
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar
from lemma.policies.interfaces import TIMEOUT_S

if TYPE_CHECKING:
    from lemma.evaluation.analysis.result import Cell
    from lemma.evaluation.records import Row

_ALL = "all"
_COMPLAINTS = 5
_AT_INTERRUPT = (
    "{done} of {total} episodes are kept in episodes.jsonl. The same command goes on "
    "from there; it plays groups of ten again that were not finished, because the last "
    "bits of a network depend on what is in its batch."
)


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """What is asked of the policy."""

    instructions: Annotated[str, tyro.conf.arg(metavar="KIND,...")] = "high-level"
    """Kinds of instructions: high-level, human, unseen, blind; or all that the tasks
    have."""
    tasks: Annotated[str, tyro.conf.arg(metavar="TASK,...")] = _ALL
    """Names of tasks, separated by commas."""
    split: Word = None
    """Frozen list of instances: test by default; or free, which samples them, as it
    does by default with tasks of your own. Split free needs --episodes."""
    episodes: Number = None
    """Only the first so many of every task."""
    planning: Literal["single-step", "multi-step"] = "single-step"
    """Look before every sub-task, or plan from the first image alone."""
    gta: Flag = False
    """Ground-truth allocation: the right robot replaces the planner's choice."""
    timeout_s: Annotated[float, tyro.conf.arg(name="timeout", metavar="SECONDS")] = (
        TIMEOUT_S
    )
    """Time for a decision of your own class or server [s]; 0: any, and unguarded."""
    language: Literal["full", "none", "shuffled", "swapped"] = "full"
    """Controls. none: nothing is said; shuffled: what belongs to the next instance;
    swapped: other colors, which ask for another goal on the same table."""
    perturb_start: Flag = False
    """Objects begin up to 3 cm and 15 degrees from where the instances say."""
    protocol: Literal["both", "strict"] = "both"
    """Two verdicts, or one. strict: the first sub-task that its robot cannot do ends an
    episode. both: it then goes on, for the lenient verdict; one play gives the two."""


EVERYTHING = EvaluateOptions()
"""High-level instructions, all tasks, the whole test split."""

QuestionOptions = Annotated[EvaluateOptions, tyro.conf.arg(name="")]
"""The fields as options of the verb."""


def evaluate(
    policy: Annotated[str, tyro.conf.arg(metavar="POLICY")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    ask: QuestionOptions = EVERYTHING,
    working: WorkerOptions = DEFAULT,
    as_json: JsonFlag = False,
) -> int:
    """Let a policy play the episodes of a frozen split, and count its successes.

    What is there already is kept, so the same command goes on where it was stopped.

    Args:
        policy: oracle; a model; PLANNER+GROUNDER; package.module:Class; or the address
            of a server, http://HOST:PORT.
        out: Folder of the result: one line per episode in episodes.jsonl, counts and
            causes of failure in summary.json.
        ask: What is asked of the policy.
        working: Where to work.
        as_json: Print one JSON object instead of a table.
    """
    # Imported here, so that help does not wait for it.
    from lemma.evaluation.analysis.result import summarise
    from lemma.evaluation.records import SUMMARY, read_about
    from lemma.evaluation.run.evaluate import EvaluationConfig
    from lemma.evaluation.run.evaluate import evaluate as run
    from lemma.evaluation.run.protocol import NAME, departures
    from lemma.policies.spec import PolicySpec
    from lemma.tasks.language.blind import kinds_of
    from lemma.tasks.suite import FREE_SPLIT, SUITE, has_frozen_lists

    tasks = _names(ask.tasks, SUITE)
    split = "test" if all(map(has_frozen_lists, tasks)) else FREE_SPLIT
    split = ask.split or split
    config = EvaluationConfig(
        out=out,
        policy=PolicySpec(policy, ask.planning, ask.gta, ask.timeout_s),
        tasks=tasks,
        split=split,
        kinds=_names(ask.instructions.replace("-", "_"), kinds_of(tasks, split)),
        episodes=ask.episodes,
        language=ask.language,
        perturb_start=ask.perturb_start,
        verdicts=ask.protocol,
    )
    for departure in departures():
        complain(f"This is not protocol {NAME}, and its result says so: {departure}.")
    with progress_bar("evaluate", config.total, _AT_INTERRUPT) as advance:
        rows = run(config, working.make_engine(), advance)
    result = summarise(rows, read_about(out), config.command())
    result.write(out / SUMMARY)
    complain_of(rows)
    if as_json:
        print_json(_rates(result.cells, config.kinds))
    else:
        output().print(table(result.cells))
    return 0


def complain_of(rows: "list[Row]") -> None:
    """Say which episodes failed because the policy itself did."""
    faulty = [row for row in rows if row.get("policy_error")]
    if not faulty:
        return
    for row in faulty[:_COMPLAINTS]:
        error = row["policy_error"]
        complain(
            f"{row['task']} {row['index']}: {error['kind']}: {error['explanation']}"
        )
    complain(
        f"{len(faulty)} of {len(rows)} episodes failed because the policy did "
        "(policy_error in episodes.jsonl)."
    )


def _names(text: str, every: tuple[str, ...]) -> tuple[str, ...]:
    return every if text == _ALL else tuple(text.split(","))


def _rates(
    cells: "tuple[Cell, ...]", kinds: tuple[str, ...]
) -> dict[str, dict[str, dict[str, Any]]]:
    """Return rates of success by kind of instruction and task, ready for JSON."""
    from lemma.evaluation.analysis.intervals import leniently, rates_by

    strict = rates_by(cells, "kind", "task")
    lenient = rates_by(leniently(cells), "kind", "task")
    found: dict[str, dict[str, dict[str, Any]]] = {kind: {} for kind in kinds}
    for (kind, task), rate in strict.items():
        later = lenient.get((kind, task))
        found[kind][task] = asdict(rate) | {
            "success_rate": rate.success_rate,
            "lenient_success_rate": later.success_rate if later else None,
        }
    return found


def table(cells: "tuple[Cell, ...]") -> Table:
    """Return success rates [%] for a terminal: tasks down, kinds across."""
    from lemma.evaluation.report.success_tables import rates

    found = rates(cells)
    first, *kinds = found.header
    # Four kinds fit into 80 columns without the edge.
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    shown.add_column(first, style="bold", no_wrap=True)
    for kind in kinds:
        shown.add_column(kind, justify="right", no_wrap=True)
    for number, row in enumerate(found.rows):
        if number == len({cell.task for cell in cells}):
            shown.add_section()
        shown.add_row(*row)
    return shown
