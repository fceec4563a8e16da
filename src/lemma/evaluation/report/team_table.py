"""The table of robots that act together: success and use of time."""

from collections.abc import Sequence

from lemma.core.tables import Table
from lemma.evaluation.analysis.team_scores import CAUSES, TeamScores
from lemma.evaluation.report.policy_results import NOTHING


def team_table(scores: Sequence[TeamScores]) -> Table:
    """Return success, makespan, idle time by cause and clearance, a column per task.

    Args:
        scores: Scores of each task.
    """
    rows = [
        ("success", *(f"{one.successes} of {one.episodes}" for one in scores)),
        ("makespan [s]", *(_number(one.makespan_s, 1) for one in scores)),
        ("over executed oracle", *(_number(one.over_oracle, 2) for one in scores)),
        ("schedule score", *(_number(one.schedule_score, 2) for one in scores)),
        ("concurrency", *(_number(one.concurrency, 2) for one in scores)),
    ]
    for cause in CAUSES:
        shares = (_number(100.0 * one.idle[cause], 0) for one in scores)
        rows.append((f"idle: {cause.replace('_', ' ')} [%]", *shares))
    gaps = (_number(one.clearance_mm, 0) for one in scores)
    rows.append(("least clearance [mm]", *gaps))
    return Table(("", *(one.task for one in scores)), tuple(rows))


def _number(value: float | None, digits: int) -> str:
    return NOTHING if value is None else f"{value:.{digits}f}"
