"""Write the table of schedules for the test lists of teams, pass2 and stack2.

    python scripts/schedules.py 2

The argument is the number of processes. It needs the extra ``schedule``. The same
versions write the same bytes.
"""

import gzip
import json
import sys
from pathlib import Path

from lemma.core.errors import SamplingError
from lemma.core.workers.pool import ProcessPool
from lemma.env.episode import Episode
from lemma.evaluation.protocol.schedules import SCHEDULED_SPLIT, SCHEDULES, jobs_of
from lemma.expert.together import solve_together
from lemma.planning.least_makespan import least_makespan
from lemma.planning.schedule import Job, Schedule, in_order
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.names import SUITES
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import load_instance

TABLE = (
    Path(__file__).parents[1] / "src" / "lemma" / "evaluation" / "protocol" / SCHEDULES
)
TASKS = (*SUITES["teams"], "pass2", "stack2")
_CHUNK = 10


def schedule_one(instance: Instance) -> tuple[str, float]:
    """Return the order of the schedule of least makespan, and the oracle's time [s].

    Raises:
        SamplingError: No schedule is proven optimal, it has other robots than the plan,
            its times do not follow from an order, or neither execution succeeds.
    """
    jobs = jobs_of(instance)
    found = least_makespan(jobs)
    planned = tuple(job.subtask.robot for job in jobs)
    if found is None or not found.is_optimal or found.robots != planned:
        raise SamplingError(f"The least makespan of {instance.key} is not known.")
    order = next((o for stage in (0, 1) if _says(found, o := found.order(stage))), None)
    if order is None:
        raise SamplingError(f"The schedule of {instance.key} follows from no order.")
    orders = {_by_robot(order): order for order in (found.steps, plan_of(jobs))}
    times = [seconds for o in orders.values() if (seconds := _executed_s(instance, o))]
    if not times:
        raise SamplingError(f"No execution of {instance.key} succeeds.")
    return "".join(map(str, order)), round(min(times), 2)


def _says(schedule: Schedule, order: tuple[int, ...]) -> bool:
    """Return whether the times of a schedule follow from an order of its sub-tasks."""
    needs = [(k, m) for m, job in enumerate(schedule.jobs) for k in job.needs]
    if any(order.index(k) > order.index(m) for k, m in needs):
        return False
    again = in_order(schedule.jobs, order)
    return again.makespan_s == schedule.makespan_s and not again.faults()


def plan_of(jobs: tuple[Job, ...]) -> tuple[SubTask, ...]:
    """Return the sub-tasks in the planner's order."""
    return tuple(job.subtask for job in jobs)


def _by_robot(order: tuple[SubTask, ...]) -> tuple[SubTask, ...]:
    """Return the sub-tasks sorted by robot, which determine the execution."""
    return tuple(sorted(order, key=lambda subtask: subtask.robot))


def _executed_s(instance: Instance, order: tuple[SubTask, ...]) -> float | None:
    episode = Episode(instance)
    for _ in solve_together(episode, order):
        pass
    return episode.elapsed_s if episode.is_success else None


def schedule_chunk(task: str, first: int) -> dict[tuple[str, int], tuple[str, float]]:
    """Return :func:`schedule_one` of some instances of a task."""
    indices = range(first, min(first + _CHUNK, SPLITS[SCHEDULED_SPLIT]))
    return {
        (task, index): schedule_one(load_instance(task, SCHEDULED_SPLIT, index))
        for index in indices
    }


if __name__ == "__main__":
    indices = range(SPLITS[SCHEDULED_SPLIT])
    work = [(task, first) for task in TASKS for first in indices[::_CHUNK]]
    rows: dict[tuple[str, int], tuple[str, float]] = {}
    for chunk in ProcessPool(int(sys.argv[1])).run(schedule_chunk, work):
        rows.update(chunk)
    table = {
        task: {
            "order": [rows[task, index][0] for index in indices],
            "executed_s": [rows[task, index][1] for index in indices],
        }
        for task in TASKS
    }
    text = json.dumps(table, separators=(",", ":"))
    TABLE.write_bytes(gzip.compress(text.encode(), mtime=0))
