"""Progress of episodes in stages, and the verdicts on their first moves."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from lemma.evaluation.records import Row


@dataclass(frozen=True, slots=True)
class Reached:
    """Sums over the strict episodes of one kind of instructions and one task.

    :mod:`lemma.env.stages` defines stages and verdicts.
    """

    kind: str
    task: str
    episodes: int
    progress: float
    """Sum of the progress at the end."""
    furthest: float
    """Sum of the furthest progress."""
    moved: int
    """Number of episodes in which a robot moved an object."""
    understood: int
    """Number of episodes whose first moved object and its place belong to the plan."""
    allocated: int
    """Number of episodes whose first object was moved by the robot of the plan."""
    executed: int
    """Number of episodes in which a sub-task of the plan was completed with it."""
    stages: dict[str, int]
    """Number of episodes by furthest stage: ``"2 lifted"``, with the number of the
    sub-task from 1; ``""`` if no stage was reached."""


def reached_by(rows: Sequence[Row], kind: str, task: str) -> Reached:
    """Count the episodes of one kind and task.

    Args:
        rows: Lines of episodes.
        kind: Kind of instructions.
        task: Name of the task.
    """
    stages = [row["stages"] for row in rows]
    counted = Counter(
        "" if one["subtask"] is None else f"{one['subtask'] + 1} {one['stage']}"
        for one in stages
    )
    return Reached(
        kind,
        task,
        len(rows),
        progress=round(math.fsum(row["progress"] for row in rows), 6),
        furthest=round(math.fsum(one["progress"] for one in stages), 6),
        moved=sum(one["moved"] != "" for one in stages),
        understood=sum(one["understood"] is True for one in stages),
        allocated=sum(one["allocated"] is True for one in stages),
        executed=sum(one["executed"] is True for one in stages),
        stages=dict(sorted(counted.items())),
    )
