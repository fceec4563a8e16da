"""The schedule of least makespan, computed by the CP-SAT solver of OR-Tools."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from ortools.sat.python import cp_model

from lemma.planning.lines import Line, are_near
from lemma.planning.schedule import CS, HORIZON_S, Job, Schedule

_WORTH = 10_000
"""Factor by which utilities are scaled before they are rounded for the solver."""


def least_makespan(jobs: Sequence[Job], limit_s: float = 10.0) -> Schedule | None:
    """Return the schedule of highest utility among those of least makespan.

    Args:
        jobs: The sub-tasks.
        limit_s: Time limit of the solver for each of its two calls [s].

    Returns:
        The schedule; None if the solver finds none, for example because the sub-tasks
        take longer than T_max.
    """
    model, late = cp_model.CpModel(), round(CS * HORIZON_S)
    # Times of each sub-task: begin, picked, effect, end.
    at = [[model.new_int_var(0, late, "") for _ in range(4)] for _ in jobs]
    who = [{robot: model.new_bool_var("") for robot in job.options} for job in jobs]
    for chosen in who:
        model.add_exactly_one(chosen.values())
    _exclude(model, jobs, at, who)
    for m, job in enumerate(jobs):
        for k, why in job.needs.items():
            model.add(at[m][0 if why == "pick" else 1] >= at[k][2])
        if job.meets is not None:
            model.add(at[m][2] == at[job.meets][2])
    options = [
        (job, robot, here)
        for job, chosen in zip(jobs, who, strict=True)
        for robot, here in chosen.items()
    ]
    durations = [job.times(robot)[3] * here for job, robot, here in options]
    model.add(cp_model.LinearExpr.sum(durations) <= late)
    makespan = model.new_int_var(0, late, "")
    model.add_max_equality(makespan, [stages[3] for stages in at])
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = limit_s
    solver.parameters.num_workers = 1
    model.minimize(makespan)
    status = solver.solve(model)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return None
    model.add(makespan <= solver.value(makespan))
    worth = [
        round(_WORTH * job.utilities[robot]) * here for job, robot, here in options
    ]
    model.maximize(cp_model.LinearExpr.sum(worth))
    solver.solve(model)
    robots = tuple(
        next(robot for robot, here in chosen.items() if solver.value(here))
        for chosen in who
    )
    starts = tuple(solver.value(stages[0]) for stages in at)
    return Schedule(tuple(jobs), robots, starts, status == cp_model.OPTIMAL)


def _exclude(
    model: cp_model.CpModel,
    jobs: Sequence[Job],
    at: Sequence[Sequence[Any]],
    who: Sequence[Mapping[str, Any]],
) -> None:
    """Add constraints on durations, and on stages that exclude each other.

    Args:
        model: The model to extend.
        jobs: The sub-tasks.
        at: Time variables of each sub-task: begin, picked, effect, end.
        who: Boolean variables of each sub-task by robot: whether the robot does it.
    """
    busy: dict[str, list[Any]] = {}
    stays: list[tuple[int, str, Line, Any]] = []
    for m, (job, stages) in enumerate(zip(jobs, at, strict=True)):
        for robot, here in who[m].items():
            times = job.times(robot)
            for stage, time in zip(stages, times, strict=True):
                model.add(stage == stages[0] + time).only_enforce_if(here)
            spans = [
                model.new_optional_interval_var(
                    stages[i], times[k] - times[i], stages[k], here, ""
                )
                for i, k in ((0, 3), (0, 1), (1, 2))
            ]
            for name in job.team(robot):
                busy.setdefault(name, []).append(spans[0])
                for line, span in zip(job.lines[name], spans[1:], strict=True):
                    stays.append((m, name, line, span))
    for of_one in busy.values():
        model.add_no_overlap(of_one)
    for (m, robot, line, span), (k, other, too, span_too) in combinations(stays, 2):
        if m != k and robot != other and are_near(line, too):
            model.add_no_overlap((span, span_too))
