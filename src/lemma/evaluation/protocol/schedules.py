"""Schedules of the frozen test lists, and scores of teams at work at the same time.

A small table in the package, made by ``python scripts/schedules.py``: for each test
instance of the suite ``teams``, of pass2 and of stack2 the order of the sub-tasks in
the schedule of least makespan, and how long the executed oracle takes. The sub-tasks
are those of the planner, and the times of the schedule follow from the order.
"""

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from lemma.core.errors import SamplingError
from lemma.core.seeding import ordered_sum
from lemma.env.simulation import Simulation
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.schedule import (
    Job,
    Schedule,
    in_order,
    pose_jobs,
    predecessors,
)
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import SHARED, pair_regions
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import load_instance

SCHEDULES = "schedules.json.gz"
"""File in the package."""
SCHEDULED_SPLIT = "test"


def jobs_of(instance: Instance) -> tuple[Job, ...]:
    """Return the sub-tasks of the planner's plan, with all robots that can do them.

    Raises:
        SamplingError: There is no plan.
    """
    now = SymbolicState.observe(Simulation(instance.scene).scene)
    grounder = GeometricGrounder(instance.scene)
    plan = find_plan(now, instance.goal, grounder)
    if plan is None:
        raise SamplingError(f"There is no plan for {instance.key}.")
    return pose_jobs(now, plan, instance.goal, grounder)


def schedule_of(instance: Instance) -> Schedule:
    """Return the schedule of least makespan, from the table or computed.

    Raises:
        SamplingError: There is no plan, or none within T_max.
        ImportError: It is not in the table, and OR-Tools is missing, the extra
            ``schedule``.
    """
    jobs, frozen = jobs_of(instance), _entry(instance, "order")
    if frozen is not None:
        # Every schedule of the table is optimal, or it would not have been written.
        return in_order(jobs, tuple(map(int, frozen)), is_optimal=True)
    # OR-Tools is an extra.
    from lemma.planning.least_makespan import least_makespan  # noqa: PLC0415

    found = least_makespan(jobs)
    if found is None:
        raise SamplingError(f"No schedule of {instance.key} was found.")
    return found


def executed_s(instance: Instance) -> float | None:
    """Return how long the executed oracle takes for an instance [s].

    Returns:
        The shorter of two executions with all robots at once, of the planner's order
        and of the schedule's; None for instances that are not in the table, also where
        objects begin elsewhere.
    """
    found: float | None = _entry(instance, "executed_s")
    if found is None:
        return None
    listed = load_instance(instance.task, instance.split, instance.index)
    return found if listed.scene == instance.scene else None


def _entry(instance: Instance, column: str) -> Any:
    listed = _table().get(instance.task, {}).get(column)
    if instance.split != SCHEDULED_SPLIT or listed is None:
        return None
    return listed[instance.index]


@cache
def _table() -> dict[str, Any]:
    source = files("lemma.evaluation.protocol") / SCHEDULES
    table: dict[str, Any] = json.loads(gzip.decompress(source.read_bytes()))
    return table


def schedule_score(success: bool, makespan_s: float, oracle_s: float) -> float:
    """Return success x min(1, executed oracle / makespan), in [0, 1].

    Args:
        success: Whether the episode succeeded.
        makespan_s: When its last sub-task ended [s].
        oracle_s: See :func:`executed_s` [s].
    """
    return min(1.0, oracle_s / makespan_s) if success else 0.0


@dataclass(frozen=True)
class TeamTimes:
    """How the robots of a team spent an episode, each from 0 to the makespan [s]."""

    makespan_s: float
    """When the last sub-task ended."""
    busy_s: dict[str, float]
    """By robot: in sub-tasks, without waiting."""
    waiting_s: dict[str, float]
    """In sub-tasks, for a region that another robot held."""
    thinking_s: dict[str, float]
    """Free before a sub-task, although nothing that it depends on was missing."""
    predecessor_s: dict[str, float]
    """Free before a sub-task, until what it depends on was done."""
    no_work_s: dict[str, float]
    """Free after its last sub-task."""
    parallel_s: float
    """While two robots or more were in sub-tasks."""

    @property
    def concurrency(self) -> float:
        """Robots that were busy, as a mean over the makespan."""
        return ordered_sum(self.busy_s.values()) / max(self.makespan_s, 1e-9)


@dataclass(frozen=True)
class Worked:
    """One sub-task that was carried out."""

    robot: str
    start_s: float
    end_s: float
    waited_s: float = 0.0
    """Of that, waiting for a region [s]."""
    ready_s: float = 0.0
    """When what it depends on was done [s]."""


def team_times(robots: Sequence[str], worked: Sequence[Worked]) -> TeamTimes:
    """Return how the robots of a team spent an episode.

    Args:
        robots: The team.
        worked: All sub-tasks; those of one robot do not overlap.
    """
    makespan_s = max((one.end_s for one in worked), default=0.0)
    names = ("busy", "waiting", "thinking", "predecessor", "no_work")
    spent: Mapping[str, dict[str, float]] = {
        name: dict.fromkeys(robots, 0.0) for name in names
    }
    free = dict.fromkeys(robots, 0.0)
    for one in sorted(worked, key=lambda one: one.start_s):
        ready_s = min(max(one.ready_s, free[one.robot]), one.start_s)
        for name, seconds in (
            ("busy", one.end_s - one.start_s - one.waited_s),
            ("waiting", one.waited_s),
            ("predecessor", ready_s - free[one.robot]),
            ("thinking", one.start_s - ready_s),
        ):
            spent[name][one.robot] += seconds
        free[one.robot] = one.end_s
    spent["no_work"].update({name: makespan_s - free[name] for name in robots})
    edges = sorted(
        [(one.start_s, 1) for one in worked] + [(one.end_s, -1) for one in worked]
    )
    parallel_s, since, at_work = 0.0, 0.0, 0
    for time, change in edges:
        parallel_s += time - since if at_work > 1 else 0.0
        since, at_work = time, at_work + change
    return TeamTimes(
        makespan_s,
        **{f"{name}_s": spent[name] for name in names},
        parallel_s=parallel_s,
    )


def worked_in(subtasks: Sequence[Mapping[str, Any]], robots: int) -> list[Worked]:
    """Return how the sub-tasks of an episode's line followed each other.

    Args:
        subtasks: Of the line, whether robots acted together or in turns.
        robots: Number of robots.
    """
    ordered = sorted(subtasks, key=lambda step: step["start_s"])
    names = [SubTask.from_dict(dict(step)) for step in ordered]
    needs = predecessors(names, (SHARED, *pair_regions(robots)))
    ends = [step["start_s"] + step["duration_s"] for step in ordered]
    effects = [
        end if step.get("effect_s") is None else step["effect_s"]
        for step, end in zip(ordered, ends, strict=True)
    ]
    return [
        Worked(
            robot,
            step["start_s"],
            end,
            step.get("waited_s") or 0.0,
            max((effects[i] for i in needed), default=0.0),
        )
        for step, end, needed in zip(ordered, ends, needs, strict=True)
        for robot in (step["robot"], step.get("partner"))
        if robot
    ]
