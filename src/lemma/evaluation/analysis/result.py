"""Results small enough to be committed: counts, causes and provenance.

The same episodes give the same bytes: a result has no wall-clock fields.
"""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

import msgspec

from lemma.core.errors import DatasetError
from lemma.core.files import read_json, write_text
from lemma.evaluation.analysis.coordination import Coordination, coordination_of
from lemma.evaluation.analysis.failure_causes import cause_of
from lemma.evaluation.analysis.pair_scores import PairScores, pair_scores
from lemma.evaluation.analysis.planning_effort import Planning, effort_of
from lemma.evaluation.analysis.rates import Cell, rates_in_words
from lemma.evaluation.analysis.reached import Reached, reached_by
from lemma.evaluation.analysis.team_scores import TeamScores, team_scores
from lemma.evaluation.records import (
    POSE_TOLERANCE_MM,
    RESULT_VERSION,
    STATE,
    WALL_CLOCK,
    Row,
    check_about,
    place_of,
    training_seed,
)
from lemma.tasks.language.template import ALL_KINDS
from lemma.tasks.names import task_rank


@dataclass(frozen=True, slots=True)
class Loss:
    """Failed episodes of one kind and task that have one cause."""

    kind: str
    task: str
    cause: str
    episodes: int


@dataclass(frozen=True, slots=True)
class Precision:
    """Errors of the poses of one kind and task, where they are defined."""

    kind: str
    task: str
    end: str
    """``"pick"`` or ``"place"``."""
    poses: int
    """Number of poses in sub-tasks that are the expert's."""
    median_mm: float
    missed: int
    """Number of poses that are more than 20 mm off."""


@dataclass(frozen=True, slots=True)
class Asked:
    """How often the other goals of language controls held."""

    kind: str
    task: str
    episodes: int
    """Number of episodes whose sentence asked for another feasible goal."""
    held: int
    """Number of episodes in which that goal held at the end."""


@dataclass(frozen=True)
class Result:
    """Counts of the episodes of a split, played by one policy of one training seed."""

    about: dict[str, Any]
    """Policy, split, horizon, versions and weights, which determine the result."""
    command: str
    """The command line that produces it."""
    episodes_sha256: str
    """SHA-256 of the episodes' lines without wall-clock fields."""
    cells: tuple[Cell, ...]
    losses: tuple[Loss, ...] = ()
    precisions: tuple[Precision, ...] = ()
    coordination: tuple[Coordination, ...] = ()
    asked: tuple[Asked, ...] = ()
    reached: tuple[Reached, ...] = ()
    planning: tuple[Planning, ...] = ()
    """Effort of planning; only for policies that count it."""
    teams: tuple[TeamScores, ...] = ()
    """Use of time by task; only for robots that act together and tasks for teams."""
    pairs: tuple[PairScores, ...] = ()
    """Refusals by kind of instructions; only in the split of pairs."""
    experiment: str = ""
    """Name of its experiment, if any."""
    version: str = field(default=RESULT_VERSION)

    @property
    def seed(self) -> int:
        """The training seed; 0 if nothing was trained."""
        return training_seed(self.about["weights"])

    @property
    def extents(self) -> Counter[tuple[str, str]]:
        """Its numbers of episodes by kind of instruction and task."""
        counted: Counter[tuple[str, str]] = Counter()
        for cell in self.cells:
            counted[cell.kind, cell.task] += cell.episodes
        return counted

    def write(self, path: Path) -> None:
        """Write the result, with the same bytes for the same result.

        Each entry is one line. Column names are written once, to keep the file small.
        """
        data = asdict(self)
        tables = {name: data.pop(name) for name in _TABLES}
        text = json.dumps(data, indent=1, sort_keys=True).removesuffix("\n}")
        for name, entries in tables.items():
            if not entries:
                continue
            columns = json.dumps(list(entries[0]))
            lines = ",\n".join(f"   {json.dumps([*e.values()])}" for e in entries)
            text += f',\n "{name}": {{\n  "columns": {columns},'
            text += f'\n  "rows": [\n{lines}\n  ]\n }}'
        write_text(path, text + "\n}\n")


_TABLES = (
    *("cells", "losses", "precisions", "coordination", "asked", "reached"),
    *("planning", "teams", "pairs"),
)
"""Fields that are tables; left out if empty."""


def read_result(path: Path) -> Result:
    """Read a result.

    Raises:
        DatasetError: It is missing, damaged, of another version, or contradicts itself.
    """
    data = read_json(path)
    if data.get("version") != RESULT_VERSION:
        raise DatasetError(
            f"{path} is no result of version {RESULT_VERSION}. 'lemma evaluate' writes "
            "results as summary.json, 'lemma reproduce' as seed-N.json."
        )
    try:
        tables = {name: _entries(data[name]) for name in _TABLES if name in data}
        result = msgspec.convert({**data, **tables}, Result)
    except (msgspec.ValidationError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path} is damaged: {error}. Delete it and evaluate again."
        ) from error
    check_about(result.about, path)
    _check_counts(path, result)
    return result


def _entries(table: Any) -> list[dict[str, Any]]:
    """Return a table's rows as dictionaries; older files have a list of these."""
    if isinstance(table, list):
        return table
    columns = table["columns"]
    return [dict(zip(columns, row, strict=True)) for row in table["rows"]]


def _check_counts(path: Path, result: Result) -> None:
    """Check that kinds are known, rates lie within [0, 1], and all losses have causes.

    Raises:
        DatasetError: A check fails.
    """
    failed: Counter[tuple[str, str]] = Counter()
    lost: Counter[tuple[str, str]] = Counter()
    for cell in result.cells:
        most = cell.lenient_successes
        most = cell.successes if most is None else most
        if not (
            cell.kind in ALL_KINDS
            and 0 <= cell.successes <= most <= cell.episodes
            and 0 <= cell.progress <= cell.episodes >= 1
        ):
            raise DatasetError(f"{path} counts what cannot be: {cell}. Evaluate again.")
        failed[cell.kind, cell.task] += cell.episodes - cell.successes
    for loss in result.losses:
        lost[loss.kind, loss.task] += loss.episodes
    for kind, task in failed.keys() | lost.keys():
        if failed[kind, task] != lost[kind, task]:
            raise DatasetError(
                f"{path} counts {failed[kind, task]} failed {kind} episodes of {task}, "
                f"and causes of {lost[kind, task]}. Delete it and evaluate again."
            )


def lines_of(result: Result, rows: Iterable[Row]) -> list[Row]:
    """Return the lines counted by a result: the first ones of its kinds and tasks.

    A folder that was evaluated more than once has further lines.
    """
    counted = result.extents
    return [row for row in rows if row["index"] < counted[_question(row)]]


def counts(result: Result, rows: Sequence[Row]) -> bool:
    """Return True if lines are exactly those that a result counts."""
    # Compare rates first: they mostly differ between policies, and a digest is slow.
    if rates_in_words(result.cells) != rates_in_words(cells_of(rows)):
        return False
    return _digest(sorted(rows, key=place_of)) == result.episodes_sha256


def check_lines(result: Result, rows: Iterable[Row], path: Path, lines: Path) -> None:
    """Count the lines of a result again, and compare.

    Args:
        result: The result.
        rows: Lines beside the result, which may count only some of them.
        path: Where the result is.
        lines: Where the lines are.

    Raises:
        DatasetError: They do not give the result.
    """
    again = summarise(
        lines_of(result, rows), result.about, result.command, result.experiment
    )
    if not result.teams:  # Older results have none.
        again = replace(again, teams=())
    if again.episodes_sha256 == result.episodes_sha256 and again == result:
        return
    recorded, found = rates_in_words(result.cells), rates_in_words(again.cells)
    differing = [
        f"{' '.join(name)}: {recorded.get(name, 'none')} in the summary, "
        f"{found.get(name, 'none')} in the lines"
        for name in sorted({*recorded, *found}, key=_order)
        if recorded.get(name) != found.get(name)
    ]
    what = "; ".join(differing[:_MOST_NAMED]) or "the same rates, other episodes"
    raise DatasetError(
        f"{path} does not fit the lines in {lines}: {what}. One of them was changed. "
        "Run 'lemma evaluate' again with the same --out, which counts the lines anew; "
        "or remove the lines to report the summary alone."
    )


_MOST_NAMED = 3


def summarise(
    rows: Iterable[Row],
    about: Mapping[str, Any],
    command: str = "",
    experiment: str = "",
) -> Result:
    """Count episodes.

    Args:
        rows: Lines of ``episodes.jsonl``, in any order.
        about: Settings of the evaluation, as in ``about.json``.
        command: The command line of the evaluation.
        experiment: Name of the experiment, if any.

    Returns:
        The result, which does not depend on the machine or on the order.
    """
    ordered = sorted(rows, key=place_of)
    return Result(
        about=dict(about),
        command=command,
        episodes_sha256=_digest(ordered),
        cells=cells_of(ordered),
        losses=_losses(ordered),
        precisions=tuple(_precisions(ordered)),
        coordination=tuple(
            coordination_of(listed, *name) for name, listed in _questions(ordered)
        ),
        asked=tuple(_asked(ordered)),
        reached=tuple(
            reached_by(listed, *name) for name, listed in _questions(ordered)
        ),
        planning=tuple(
            effort_of(listed, *name)
            for name, listed in _questions(ordered)
            if any(row.get("planning") for row in listed)
        ),
        teams=team_scores(ordered),
        pairs=pair_scores(ordered),
        experiment=experiment,
    )


def cells_of(rows: Iterable[Row]) -> tuple[Cell, ...]:
    """Count the successes of episodes, by all columns of tables."""
    groups: dict[tuple[str, str, str, int], list[Row]] = {}
    for row in rows:
        name = (*_question(row), row["team"], row["distractors"])
        groups.setdefault(name, []).append(row)
    return tuple(
        Cell(
            *name,
            episodes=len(listed),
            successes=sum(bool(row["success"]) for row in listed),
            lenient_successes=_lenient_successes(listed),
            progress=round(math.fsum(row["progress"] for row in listed), 6),
        )
        for name, listed in sorted(groups.items(), key=lambda item: _order(item[0]))
    )


def _lenient_successes(rows: Sequence[Row]) -> int | None:
    """Return the number of lenient successes; None if not all have that verdict."""
    if any(row["lenient"] is None for row in rows):
        return None
    return sum(bool(row["lenient"]["success"]) for row in rows)


def _question(row: Row) -> tuple[str, str]:
    return row["instruction_kind"], row["task"]


def _questions(rows: Iterable[Row]) -> Iterable[tuple[tuple[str, str], list[Row]]]:
    """Yield groups of rows by kind and task; rows are already in that order."""
    return [(name, list(listed)) for name, listed in groupby(rows, key=_question)]


def _asked(rows: Iterable[Row]) -> Iterable[Asked]:
    for name, listed in _questions(rows):
        held = [row["asked_holds"] for row in listed if row["asked"] is not None]
        if held:
            yield Asked(*name, len(held), sum(held))


def _order(name: Sequence[Any]) -> tuple[Any, ...]:
    kind, task, *rest = name
    return ALL_KINDS.index(kind), task_rank(task), *rest


def _digest(rows: Iterable[Row]) -> str:
    lines = (json.dumps(_digested(row)) for row in rows)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _digested(row: Row) -> Row:
    kept = {k: v for k, v in row.items() if k not in (*WALL_CLOCK, STATE)}
    if kept["lenient"] is not None:
        kept["lenient"] = {k: v for k, v in kept["lenient"].items() if k != STATE}
    return kept


def _losses(rows: Iterable[Row]) -> tuple[Loss, ...]:
    causes = ((_question(row), cause_of(row)) for row in rows)
    counted = Counter((*name, str(cause)) for name, cause in causes if cause)
    return tuple(Loss(*name, counted[name]) for name in sorted(counted, key=_order))


def _precisions(rows: Iterable[Row]) -> Iterable[Precision]:
    errors: dict[tuple[str, str, str], list[float]] = {}
    for row in rows:
        for step in row["subtasks"]:
            feedback = step["expert"]
            for end in ("pick", "place"):
                error = feedback[f"{end}_error_mm"]
                if error is not None and not feedback["departure"]:
                    errors.setdefault((*_question(row), end), []).append(error)
    for name in sorted(errors, key=_order):
        found = errors[name]
        missed = sum(error > POSE_TOLERANCE_MM for error in found)
        yield Precision(*name, len(found), round(median(found), 1), missed)
