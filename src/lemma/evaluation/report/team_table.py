"""Tables of robots that act together: success and use of time.

Their rows are tasks, so that all tasks of a suite fit into a terminal of 80 columns.
"""

from collections.abc import Sequence

from lemma.core.tables import Table
from lemma.evaluation.analysis.team_scores import CAUSES, TeamScores
from lemma.evaluation.report.policy_results import NOTHING


def team_tables(scores: Sequence[TeamScores]) -> dict[str, Table]:
    """Return the tables of scores by title; none without scores."""
    if not scores:
        return {}
    return {"use of time": _use_of_time(scores), "idle time": _idle_time(scores)}


def _use_of_time(scores: Sequence[TeamScores]) -> Table:
    """Return success, makespan, scores and clearance of each task."""
    header = (
        "success",
        "makespan [s]",
        "/ oracle",
        "score",
        "concurrency",
        "clearance",
    )
    rows = (
        (
            one.task,
            f"{one.successes} of {one.episodes}",
            _number(one.makespan_s, 1),
            _number(one.over_oracle, 2),
            _number(one.schedule_score, 2),
            _number(one.concurrency, 2),
            _number(one.clearance_mm, 0, " mm"),
        )
        for one in scores
    )
    return Table(("task", *header), tuple(rows), labels=1)


def _idle_time(scores: Sequence[TeamScores]) -> Table:
    """Return the robots' idle time in each task, in percent by cause."""
    rows = (
        (one.task, *(_number(100.0 * one.idle[cause], 0) for cause in CAUSES))
        for one in scores
    )
    causes = (cause.replace("_", " ") for cause in CAUSES)
    return Table(("idle [%]", *causes), tuple(rows), labels=1)


def _number(value: float | None, digits: int, unit: str = "") -> str:
    return NOTHING if value is None else f"{value:.{digits}f}{unit}"
