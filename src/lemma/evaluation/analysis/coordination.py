"""Measures of coordination between the robots, computed from the lines of episodes.

All measures are over the strict episodes, unless they say *lenient*.

==================  ==================================================================
makespan            simulated time until the episode ends, ``elapsed_s``. It is compared
                    with the expert's on the same instance, over successful episodes
                    alone: sum of the policy's, ``timed_s``, over sum of the expert's,
                    ``expert_s``.
idle time           of one robot, ``idle_s``: makespan less the time in which it carries
                    out sub-tasks. Robots take turns, so somebody always waits.
allocation          share of sub-tasks whose robot could do them, ``able``, as the
                    expert judges by the true state before each; of those that any robot
                    could do, ``doable``. ``stop`` is none. A protective stop ends the
                    episode, so all of these are first tries. Besides: share whose robot
                    is the expert's, ``as_expert``, of the sub-tasks that are in its
                    plan, now or later, with any robot, ``planned``.
order violation     a sub-task that is in the expert's plan, but further on, which could
                    not be done yet, or was done and left as many sub-tasks to do as
                    before. Sub-tasks in any order are none. As for allocation, there is
                    nothing to count where no sub-task names objects.
clearance           smallest distance between the two arms, looked at ten times in a
                    simulated second (:mod:`lemma.evaluation.run.watches`).
                    Signed: 0 or less is touching.
==================  ==================================================================
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from lemma.evaluation.records import PROTECTIVE_STOP, Row
from lemma.motion.outcome import REFUSED


@dataclass(frozen=True, slots=True)
class Coordination:
    """Sums over the episodes of one kind of instructions and one task."""

    kind: str
    task: str
    episodes: int
    elapsed_s: float
    idle_s: dict[str, float]
    """By robot; ``robot_0`` stands at the left."""
    timed: int
    """Successful episodes whose expert's time is known."""
    timed_s: float
    expert_s: float
    doable: int
    able: int
    planned: int
    as_expert: int
    order_violations: int
    nearest_mm: float | None
    """Smallest clearance in any episode; None where no scene has two arms."""
    touching: int
    """Number of episodes."""
    stops: int
    """Episodes that ended with a protective stop."""
    refusals: int | None
    """Sub-tasks in lenient episodes that their robots could not do; None if there are
    none."""
    lenient_timed_s: float
    """As ``timed_s``, over the episodes with lenient success."""
    lenient_expert_s: float

    @property
    def judged(self) -> bool:
        """Whether any sub-task could be compared with a plan or with reach.

        None can where they name no objects, as those of end-to-end models.
        """
        return bool(self.doable or self.planned)


_COUNTED = ("doable", "able", "planned", "as_expert", "order_violations")
"""Counts in each line."""


def coordination_of(rows: Sequence[Row], kind: str, task: str) -> Coordination:
    """Sum the measures of one or more episodes of one kind and task."""
    figures = [row["coordination"] for row in rows]
    gaps = [each["clearance_mm"] for each in figures]
    clearances = [gap for gap in gaps if gap is not None]
    known = [row for row in rows if row["coordination"]["expert_s"] is not None]
    timed = [row for row in known if row["success"]]
    later = [row for row in known if row["lenient"] and row["lenient"]["success"]]
    robots = sorted({robot for row in rows for robot in row["idle_s"]})
    return Coordination(
        kind=kind,
        task=task,
        episodes=len(rows),
        elapsed_s=_sum(row["elapsed_s"] for row in rows),
        idle_s={
            robot: _sum(row["idle_s"].get(robot, 0.0) for row in rows)
            for robot in robots
        },
        timed=len(timed),
        timed_s=_sum(row["elapsed_s"] for row in timed),
        expert_s=_sum(row["coordination"]["expert_s"] for row in timed),
        **{name: sum(each[name] for each in figures) for name in _COUNTED},
        nearest_mm=min(clearances, default=None),
        touching=sum(gap <= 0.0 for gap in clearances),
        stops=sum(row["failure"] == PROTECTIVE_STOP for row in rows),
        refusals=_refusals(rows),
        lenient_timed_s=_sum(row["lenient"]["elapsed_s"] for row in later),
        lenient_expert_s=_sum(row["coordination"]["expert_s"] for row in later),
    )


def _refusals(rows: Sequence[Row]) -> int | None:
    if any(row["lenient"] is None for row in rows):
        return None
    return sum(
        step["outcome"] in REFUSED
        for row in rows
        for step in (*row["subtasks"], *row["lenient"]["subtasks"])
    )


def _sum(values: Iterable[float]) -> float:
    return round(math.fsum(values), 3)
