"""Schedules: they can be carried out, and nothing is shorter."""

import json
from dataclasses import replace
from functools import cache
from itertools import permutations

import pytest
from command import run as lemma
from tiers import slow_but

from lemma.evaluation.protocol.schedules import (
    Worked,
    schedule_of,
    schedule_score,
    team_times,
)
from lemma.planning.schedule import Schedule, in_order
from lemma.tasks.names import FAMILIES
from lemma.tasks.suite import load_instance

TASKS = (*FAMILIES, "pass2", "stack2")


@cache
def scheduled(task: str) -> Schedule:
    return schedule_of(load_instance(task, "test", 1))


@pytest.mark.parametrize("task", slow_but(TASKS, "relay", "tower", "stack2"))
def test_frozen_schedules_can_be_carried_out(task: str) -> None:
    found = scheduled(task)
    assert found.is_optimal
    assert found.faults() == []
    path = found.critical_path()
    assert found.starts[path[0]] == 0
    assert found.at(path[-1], 3) == round(100 * found.makespan_s)
    is_shorter = found.makespan_s < found.sequential_s
    assert is_shorter == (len(found.jobs) > 1)


@pytest.mark.parametrize("task", slow_but(("tower", "stack2", "sort"), "stack2"))
def test_no_order_is_shorter(task: str) -> None:
    found = scheduled(task)
    for order in permutations(range(len(found.jobs))):
        if all(order.index(k) < order.index(m) for m in order for k in needs(found, m)):
            assert in_order(found.jobs, order).makespan_s >= found.makespan_s


def needs(found: Schedule, job: int) -> tuple[int, ...]:
    return tuple(found.jobs[job].needs)


def test_the_solver_finds_the_frozen_schedule() -> None:
    module = "lemma.planning.least_makespan"
    solver = pytest.importorskip(module, exc_type=ImportError)
    for task in ("relay", "tower", "stack2", "unison"):
        found = solver.least_makespan(scheduled(task).jobs)
        assert found is not None
        assert found.makespan_s == scheduled(task).makespan_s
        assert found.robots == scheduled(task).robots


def test_what_cannot_be_carried_out_is_told() -> None:
    found = scheduled("stack2")
    faults = replace(found, starts=(0,) * len(found.jobs)).faults()
    assert any("does not wait for" in fault for fault in faults)
    assert any("at once" in fault for fault in faults)
    assert any("in each other's way" in fault for fault in faults)


def test_time_is_told_apart_by_cause() -> None:
    worked = [
        Worked("robot_0", 0.0, 6.0),
        Worked("robot_1", 5.0, 12.0, waited_s=1.0, ready_s=4.0),
        Worked("robot_0", 7.0, 10.0, ready_s=5.0),
    ]
    found = team_times(("robot_0", "robot_1"), worked)
    assert found.makespan_s == 12.0
    assert found.busy_s == {"robot_0": 9.0, "robot_1": 6.0}
    assert found.waiting_s == {"robot_0": 0.0, "robot_1": 1.0}
    assert found.predecessor_s == {"robot_0": 0.0, "robot_1": 4.0}
    assert found.thinking_s == {"robot_0": 1.0, "robot_1": 1.0}
    assert found.no_work_s == {"robot_0": 2.0, "robot_1": 0.0}
    assert found.parallel_s == 4.0
    assert found.concurrency == 1.25
    scores = [schedule_score(*each) for each in ((True, 12, 9), (True, 8, 9))]
    assert [*scores, schedule_score(False, 8, 9)] == [0.75, 1.0, 0.0]


def test_the_command_prints_a_schedule(capsys: pytest.CaptureFixture[str]) -> None:
    assert lemma("schedule", "relay", "--index", 1) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row[:7] for row in rows if row.startswith("robot_")] == [
        f"robot_{i}" for i in range(3)
    ]
    assert lemma("schedule", "relay", "--index", 1, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["makespan_s"] == scheduled("relay").makespan_s
    assert len(told["schedule"]) == len(told["jobs"]) == 3
