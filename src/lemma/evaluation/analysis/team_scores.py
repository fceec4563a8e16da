"""Scores of the use of time by teams, computed from the lines of episodes.

The same definitions, in ``docs/teams.md``, hold for robots that act together and in
turns. All scores are over the strict episodes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from lemma.evaluation.protocol.schedules import (
    executed_s,
    schedule_score,
    team_times,
    worked_in,
)
from lemma.evaluation.records import Row
from lemma.evaluation.run.evaluate import start_of
from lemma.tasks.instance import OWN_SPLIT
from lemma.tasks.names import SUITES, in_order

CAUSES = ("waiting", "predecessor", "thinking", "no_work")
"""Causes of idle time: waiting for a sector held by another robot; waiting for an
effect that its sub-task needs; waiting for a decision; no work left."""


@dataclass(frozen=True)
class TeamScores:
    """Scores of the episodes of one task."""

    task: str
    episodes: int
    successes: int
    makespan_s: float | None
    """Mean over successes [s]; None where there is none."""
    over_oracle: float | None
    """Ratio of the sums of makespans and of executed oracles over successes; None if no
    success has an executed oracle."""
    schedule_score: float | None
    """Mean over the episodes that have an executed oracle."""
    concurrency: float
    """Mean number of busy robots over the makespan, averaged over episodes."""
    idle: dict[str, float]
    """Mean fraction of the robots' time over episodes, by :data:`CAUSES`."""
    clearance_mm: float | None
    """Smallest distance of two arms in any episode [mm]."""


def team_scores(rows: Iterable[Row]) -> tuple[TeamScores, ...]:
    """Return the scores of each task whose robots act together or are a team.

    Args:
        rows: Lines of ``episodes.jsonl`` of one policy. Skipped are lines of policies
            at control level, of user-defined instances, and of turns in other suites
            than ``teams``.
    """
    wanted = [row for row in rows if _is_team(row)]
    return tuple(
        _scores(task, [row for row in wanted if row["task"] == task])
        for task in in_order(row["task"] for row in wanted)
    )


def _is_team(row: Row) -> bool:
    known = row.get("control") is None and row["split"] != OWN_SPLIT
    return known and (row.get("together") is not None or row["task"] in SUITES["teams"])


def _scores(task: str, rows: Sequence[Row]) -> TeamScores:
    figures = [_figures(row) for row in rows]
    solved = [each for row, each in zip(rows, figures, strict=True) if row["success"]]
    timed = [each for each in solved if each["oracle_s"] is not None]
    scores = [
        each["schedule_score"] for each in figures if each["schedule_score"] is not None
    ]
    gaps = [row["coordination"]["clearance_mm"] for row in rows]
    oracles_s = [each["oracle_s"] for each in timed]
    return TeamScores(
        task,
        len(rows),
        len(solved),
        fmean(each["makespan_s"] for each in solved) if solved else None,
        fmean(each["makespan_s"] for each in timed) / fmean(oracles_s)
        if timed
        else None,
        fmean(scores) if scores else None,
        fmean(each["concurrency"] for each in figures),
        {cause: fmean(each[cause] for each in figures) for cause in CAUSES},
        min((gap for gap in gaps if gap is not None), default=None),
    )


def _figures(row: Row) -> dict[str, Any]:
    """Return the scores of one episode; shares of idle time by cause."""
    robots = sorted(row["idle_s"])
    times = team_times(robots, worked_in(row["subtasks"], len(robots)))
    oracle_s, makespan_s = executed_s(start_of(row)), times.makespan_s
    whole_s, score = len(robots) * max(makespan_s, 1e-9), None
    if oracle_s is not None:
        success = row["success"] and makespan_s > 0.0
        score = schedule_score(success, makespan_s, oracle_s)
    return {
        "makespan_s": makespan_s,
        "oracle_s": oracle_s,
        "schedule_score": score,
        "concurrency": times.concurrency,
        **{
            cause: sum(map(float, getattr(times, f"{cause}_s").values())) / whole_s
            for cause in CAUSES
        },
    }
