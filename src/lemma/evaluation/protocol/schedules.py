"""Schedules of the frozen test lists, and scores of robots that act together.

``python scripts/schedules.py`` makes a table in the package. For each test instance of
the suite ``teams``, of pass2 and of stack2, it has the order of the sub-tasks in the
schedule of least makespan, and the time of the executed oracle. The sub-tasks are those
of the planner, and the times of the schedule follow from the order.
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
)
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import SHARED, pair_regions
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import load_instance
from lemma.tasks.teams.dependencies import predecessors

SCHEDULES = "schedules.json.gz"
"""Name of the table's file in the package."""
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
        # The table has only optimal schedules.
        return in_order(jobs, tuple(map(int, frozen)), is_optimal=True)
    # OR-Tools is an optional dependency.
    from lemma.planning.least_makespan import least_makespan  # noqa: PLC0415

    found = least_makespan(jobs)
    if found is None:
        raise SamplingError(f"No schedule of {instance.key} was found.")
    return found


def executed_s(instance: Instance) -> float | None:
    """Return the time of the executed oracle for an instance [s].

    Returns:
        The shorter of two executions with all robots at once, of the planner's order
        and of the schedule's; None for instances that are not in the table, including
        perturbed starts.
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
        makespan_s: Time at which its last sub-task ended [s].
        oracle_s: See :func:`executed_s` [s].
    """
    return min(1.0, oracle_s / makespan_s) if success else 0.0


@dataclass(frozen=True)
class TeamTimes:
    """Use of time by the robots of a team, each from 0 to the makespan [s]."""

    makespan_s: float
    """Time at which the last sub-task ended."""
    busy_s: dict[str, float]
    """By robot: time in sub-tasks, without waiting."""
    waiting_s: dict[str, float]
    """By robot: waiting in sub-tasks for a region that another robot holds."""
    thinking_s: dict[str, float]
    """By robot: free before a sub-task whose predecessors were done."""
    predecessor_s: dict[str, float]
    """By robot: free before a sub-task until its predecessors were done."""
    no_work_s: dict[str, float]
    """By robot: free after its last sub-task."""
    parallel_s: float
    """Time with two or more robots in sub-tasks."""

    @property
    def concurrency(self) -> float:
        """Mean number of busy robots over the makespan."""
        return ordered_sum(self.busy_s.values()) / max(self.makespan_s, 1e-9)


@dataclass(frozen=True)
class Worked:
    """One executed sub-task."""

    robot: str
    start_s: float
    end_s: float
    waited_s: float = 0.0
    """Time of waiting for a region within it [s]."""
    ready_s: float = 0.0
    """Time at which its predecessors were done [s]."""


def team_times(robots: Sequence[str], worked: Sequence[Worked]) -> TeamTimes:
    """Return the use of time by the robots of a team.

    Args:
        robots: Names of the robots.
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
    """Return the times of the sub-tasks of an episode's line.

    Args:
        subtasks: Sub-tasks of the line, of robots that act together or in turns.
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
