"""The leaderboard: results that anybody hands in, each with the lines it came from.

Run from the repository, to add a result or to write docs/leaderboard.md from all:

    python scripts/leaderboard.py add DIR NAME --title TITLE --who WHO [--link URL]
    python scripts/leaderboard.py page

An entry is ``NAME.json``: who, what, and the figures. Beside it lies ``NAME.jsonl.xz``
with the lines of the episodes, from which all figures are made again whenever it is
checked.
"""

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import read_json, write_json
from lemma.evaluation.analysis.intervals import (
    leniently,
    mean_over_tasks,
    rate_of,
    rates_by,
    wilson_interval,
)
from lemma.evaluation.analysis.result import (
    Result,
    read_result,
    summarise,
)
from lemma.evaluation.lines import (
    lines_at,
    packed_beside,
    read_lines,
    result_beside,
    write_packed,
)
from lemma.evaluation.records import (
    BOARD_SPLIT,
    PACKED,
    PROTOCOL_VERSION,
    Row,
    key_of,
    read_about,
)
from lemma.evaluation.report.policy_results import starts_perturbed
from lemma.evaluation.report.tables import ResultTable, markdown, words
from lemma.evaluation.run.evaluate import VERDICTS
from lemma.evaluation.run.language_controls import FULL
from lemma.evaluation.run.protocol import NAME, frozen, sha256_of_protocol
from lemma.policies.spec import ORACLE
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.language.blind import instruction
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE, load_instance

ROOT = Path(__file__).parents[1]
BOARD = ROOT / "leaderboard"
PAGE = ROOT / "docs" / "leaderboard.md"
_PER_TASK = SPLITS[BOARD_SPLIT]
_FREE = ("policy", "weights", "served", "lemma", "numpy", "numba", "revision")
"""What an entry says of how it was made, besides the protocol."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Submission:
    """One entry."""

    title: str
    """What the policy is called."""
    who: str
    """Who hands it in."""
    link: str = ""
    """A paper or code, if any."""
    protocol: str
    """Hash of the protocol that it follows."""
    protocol_version: int
    """Of its rules."""
    benchmark: str
    """Version of the instances."""
    command: str
    """The command line that gives it."""
    about: dict[str, Any]
    """Policy, weights and versions."""
    episodes_sha256: str
    """Of the lines of the episodes without wall-clock fields."""
    success: dict[str, dict[str, Any]]
    """By kind of instructions: episodes, successes, mean over the tasks [%] and
    successes by task, strictly; and successes and mean leniently."""

    @property
    def level(self) -> str:
        """``"control"`` if it answers motor commands; empty for sub-tasks."""
        return str(self.about["policy"].get("level", ""))

    @property
    def knows_truth(self) -> bool:
        """Whether an oracle has a part in it, so that it is a bound and no entry."""
        policy = self.about["policy"]
        named = ORACLE in policy["name"].split("+") or bool(policy["gta"])
        # A class of somebody's own may be an oracle as well.
        return named or bool(self.about.get("oracle"))


def submission_of(result: Result, title: str, who: str, link: str = "") -> Submission:
    """Return the entry of a result.

    Raises:
        InvalidConfigError: It does not follow the protocol that ships, or not to both
            verdicts, or is a control, or is not of all episodes of the test split.
    """
    _check(result)
    return Submission(
        title=title,
        who=who,
        link=link,
        protocol=result.about["protocol"],
        protocol_version=result.about["protocol_version"],
        benchmark=result.about["benchmark"],
        command=result.command,
        about={name: result.about.get(name) for name in _FREE},
        episodes_sha256=result.episodes_sha256,
        success=_success(result),
    )


def submit(folder: Path, board: Path, name: str, **told: str) -> Path:
    """Add a result to a leaderboard.

    Args:
        folder: What ``lemma evaluate`` wrote, or ``lemma reproduce`` for a seed; or
            the file of a result with lines beside it.
        board: Folder of the leaderboard.
        name: Of the entry's files.
        told: Title, who and link; see :class:`Submission`.

    Returns:
        The file of the entry.

    Raises:
        DatasetError: The result is missing or damaged.
        InvalidConfigError: It cannot be an entry.
    """
    lines = lines_at(folder)
    rows = read_lines(lines)
    command = read_result(result_beside(lines)).command
    result = summarise(rows, read_about(lines), command)
    entry = board / f"{name}.json"
    write_json(entry, asdict(submission_of(result, **told)))
    write_packed(packed_beside(entry), rows)
    return entry


def read_board(board: Path) -> dict[str, Submission]:
    """Return the entries of a leaderboard by name, each as its file says.

    Raises:
        DatasetError: One is damaged.
    """
    found = {}
    for path in sorted(board.glob("*.json")):
        try:
            found[path.stem] = Submission(**read_json(path))
        except TypeError as error:
            raise DatasetError(
                f"{path} is no entry: {error}. Submit it again."
            ) from error
    return found


def check_submission(board: Path, name: str) -> None:
    """Make an entry's figures again from its lines, and compare.

    Raises:
        DatasetError: They differ, or the lines are missing or damaged.
        InvalidConfigError: The lines cannot be those of an entry.
    """
    said = read_board(board)[name]
    path = board / f"{name}{PACKED}"
    rows = read_lines(path)
    _check_lines(path, rows)
    about = {
        **said.about,
        "protocol": said.protocol,
        "protocol_version": said.protocol_version,
        "benchmark": said.benchmark,
        "verdicts": VERDICTS[0],
        "language": FULL,
        "perturb_start": False,
        "split": BOARD_SPLIT,
    }
    result = summarise(rows, about, said.command)
    made = submission_of(result, said.title, said.who, said.link)
    # As JSON reads it back.
    here = json.loads(json.dumps(asdict(made)))
    differing = [part for part, value in here.items() if value != asdict(said)[part]]
    if differing:
        raise DatasetError(
            f"{board / name}.json says another {', '.join(differing)} than its lines "
            f"in {path.name}. Submit the result again."
        )


def _check_lines(path: Path, rows: list[Row]) -> None:
    """Check that each line begins with its own start and sentence."""
    for row in rows:
        own = load_instance(row["task"], BOARD_SPLIT, row["index"])
        plain = row["split"] == BOARD_SPLIT and not row["perturb_start"]
        plain = plain and row["benchmark"] == BENCHMARK_VERSION and row["lenient"]
        sentence = instruction(own, row["instruction_kind"])
        if not plain or row["instruction"] != sentence:
            raise DatasetError(
                f"{path} has a line that is no episode of the board: "
                f"{' '.join(map(str, key_of(row)))}. Submit the result again."
            )


def leaders(board: dict[str, Submission], kind: str, *, truth: bool) -> ResultTable:
    """Return the entries with a kind of instructions, the best first.

    Args:
        board: All entries.
        kind: Of instructions.
        truth: Whether those that know the truth, or the others.
    """
    entries = [one for one in board.values() if kind in one.success]
    entries = [one for one in entries if one.knows_truth == truth]
    entries.sort(key=lambda one: (-one.success[kind]["mean"], one.title))
    rows = []
    for one in entries:
        told = one.success[kind]
        low, high = wilson_interval(told["successes"], told["episodes"])
        mean = f"{told['mean']:.1f} ({100 * low:.0f}–{100 * high:.0f})"
        won = (told["tasks"][task] for task in SUITE)
        each = (f"{100 * count / _PER_TASK:.1f}" for count in won)
        title = f"[{one.title}]({one.link})" if one.link else one.title
        if one.level:
            title += f", {one.level} level"
        lenient = f"{told['lenient_mean']:.1f}"
        digest = f"`{one.episodes_sha256[:12]}`"
        rows.append((title, one.who, *each, mean, lenient, digest))
    header = ("success [%]", "who", *SUITE, "mean", "lenient", "episodes")
    return ResultTable(header, tuple(rows), labels=2)


def board_page(board: dict[str, Submission]) -> str:
    """Return the page of a leaderboard."""
    text = _INTRODUCTION.format(
        name=NAME,
        protocol=sha256_of_protocol(frozen())[:12],
        version=PROTOCOL_VERSION,
        benchmark=BENCHMARK_VERSION,
    )
    for kind in EVALUATION_KINDS:
        table = leaders(board, kind, truth=False)
        body = markdown(table) if table.rows else "There are no entries yet.\n"
        text += f"\n## {words(kind, '-').capitalize()} instructions\n\n{body}"
        bounds = leaders(board, kind, truth=True)
        if bounds.rows:
            text += f"\nBounds: these know the true state.\n\n{markdown(bounds)}"
    return text


_INTRODUCTION = """\
# Leaderboard

Results that were handed in: all 60 test episodes of each task of benchmark
`{benchmark}`, under protocol {version} (`{name}`, `{protocol}`, [](protocol.md)).
Success is strict: the first sub-task that the chosen robot cannot do ends the episode.
The mean is over the tasks, with the 95 % Wilson interval of all episodes; *lenient* is
the mean where the policy is told, and goes on. The last column begins the SHA-256 of
the lines of the episodes, which lie beside each entry; a test makes every figure from
them again. This page is written by `python scripts/leaderboard.py page`.

To hand in a result, evaluate a policy and open a pull request with the two files that
the second command writes into `leaderboard`:

```
lemma evaluate --policy mypackage.mymodule:MyPolicy --instructions all --out out/mine
python scripts/leaderboard.py add out/mine mine --title "My policy" --who "Me"
```

Lines of another protocol or benchmark are refused. What knows the true state, such as
the expert or the right robot, stands apart from what has learned, as a bound of what
can be reached.
"""


def _check(result: Result) -> None:
    about = result.about
    said = about.get("protocol_version"), about.get("benchmark")
    if said != (PROTOCOL_VERSION, BENCHMARK_VERSION):
        raise InvalidConfigError(
            f"The result is of protocol {said[0]} and benchmark {said[1]}, and the "
            f"leaderboard is of protocol {PROTOCOL_VERSION} and benchmark "
            f"{BENCHMARK_VERSION}. Evaluate again with this version."
        )
    if about["verdicts"] != VERDICTS[0]:
        raise InvalidConfigError(
            "The result has no lenient verdicts. Evaluate again without --protocol."
        )
    ships = sha256_of_protocol(frozen())
    if about.get("protocol") != ships:
        raise InvalidConfigError(
            f"The result follows protocol {about.get('protocol')}, and the leaderboard "
            f"is of {ships} ({NAME}). Evaluate again with this version."
        )
    plain = about["language"] == FULL and not starts_perturbed(result)
    if about["split"] != BOARD_SPLIT or not plain:
        raise InvalidConfigError(
            f"The leaderboard takes split {BOARD_SPLIT!r} with whole sentences and the "
            "instances' own starts. Evaluate without --split, --language and "
            "--perturb-start."
        )
    limited = [name for name, told in about["weights"].items() if told.get("ended")]
    if limited:
        raise InvalidConfigError(
            f"A time limit ended the training of {', '.join(limited)}, so that nobody "
            "can repeat it. Train without --time-limit-s."
        )
    episodes = rates_by(result.cells, "kind", "task")
    for kind in {cell.kind for cell in result.cells}:
        for task in SUITE:
            found = episodes.get((kind, task))
            count = 0 if found is None else found.episodes
            if count != _PER_TASK:
                raise InvalidConfigError(
                    f"The result has {count} of the {_PER_TASK} {kind} episodes of "
                    f"{task}. Evaluate all of them."
                )


def _success(result: Result) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for kind in EVALUATION_KINDS:
        cells = [cell for cell in result.cells if cell.kind == kind]
        if cells:
            rates = rates_by(cells, "task")
            found[kind] = {
                "episodes": rate_of(cells).episodes,
                "successes": rate_of(cells).successes,
                "lenient_successes": rate_of(leniently(cells)).successes,
                "mean": round(100.0 * mean_over_tasks(cells), 4),
                "lenient_mean": round(100.0 * mean_over_tasks(leniently(cells)), 4),
                "tasks": {task: rates[task,].successes for task in SUITE},
            }
    return found


def text() -> str:
    """Return the page."""
    return board_page(read_board(BOARD))


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description="The leaderboard.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    add = verbs.add_parser("add", help="add what lemma evaluate wrote")
    add.add_argument("folder", type=Path)
    add.add_argument("name")
    add.add_argument("--title", required=True)
    add.add_argument("--who", required=True)
    add.add_argument("--link", default="")
    verbs.add_parser("page", help="write the page")
    asked = parser.parse_args()
    if asked.verb == "add":
        told = {"title": asked.title, "who": asked.who, "link": asked.link}
        submit(asked.folder, BOARD, asked.name, **told)
        check_submission(BOARD, asked.name)
    PAGE.write_text(text(), encoding="utf-8")


if __name__ == "__main__":
    main()
