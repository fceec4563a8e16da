"""Robots that act at the same time: the same lines and verdicts, and what is added."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError
from lemma.core.workers.pool import Serial
from lemma.env.episode import Episode
from lemma.evaluation.analysis.team_scores import team_scores
from lemma.evaluation.lines import read_rows, write_rows
from lemma.evaluation.records import EPISODES, Row
from lemma.evaluation.run.config import EvaluationConfig, acting_by_default
from lemma.evaluation.run.evaluate import evaluate
from lemma.evaluation.verification import verify
from lemma.expert.expert import Expert
from lemma.expert.together import solve_together
from lemma.policies.interfaces import Decision
from lemma.policies.spec import PolicySpec
from lemma.policies.together.interfaces import (
    Choice,
    RobotInput,
    RobotPolicy,
    TeamInput,
    TeamPolicy,
)
from lemma.tasks.subtask import STOP, SubTask
from lemma.tasks.suite import load_instance


def play(out: Path, policy: str, task: str, **told: Any) -> list[Row]:
    spec = PolicySpec(policy, acting="together", **told)
    config = EvaluationConfig(out=out, policy=spec, tasks=(task,), episodes=1)
    return evaluate(config, Serial())


def plan_of(task: str) -> tuple[SubTask, ...]:
    episode = Episode(load_instance(task, "test", 0))
    plan = Expert(episode.simulation.scene, episode.instance.goal).plan()
    assert plan is not None
    return plan.subtasks


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The expert's result in an episode of three robots."""
    path = tmp_path_factory.mktemp("together")
    play(path, "oracle", "sort")
    return path


def test_the_experts_line_is_that_of_its_execution(folder: Path) -> None:
    (row,) = read_rows(folder)
    episode = Episode(load_instance("sort", "test", 0))
    for _ in solve_together(episode):
        pass
    assert row["success"]
    told = row["together"]
    assert row["elapsed_s"] == told["makespan_s"] == round(episode.elapsed_s, 3)
    assert row["state_sha256"] == episode.simulation.scene.state_hash()
    assert told["schedule_score"] == 1.0
    assert told["concurrency"] > 1.0
    assert told["contact_s"] == 0.0
    assert len(told["orders"]) == len(row["subtasks"]) == len(plan_of("sort"))
    for robot, busy_s in told["busy_s"].items():
        idle = ("waiting", "thinking", "predecessor", "no_work")
        spent = [told[f"{name}_s"][robot] for name in idle]
        assert busy_s + sum(spent) == pytest.approx(told["makespan_s"], abs=0.01)


FORGERIES = (
    *("", "makespan_s is 9.0", "clearance_mm is 999.0"),
    *("success", "another way of acting"),
)
"""The verification's words on them; none on no line."""


@pytest.mark.parametrize("what", slow_but(FORGERIES, "", "makespan_s is 9.0"))
def test_a_line_is_executed_again_and_forgeries_are_refused(
    folder: Path, tmp_path: Path, what: str
) -> None:
    (row,) = read_rows(folder)
    (tmp_path / "about.json").write_bytes((folder / "about.json").read_bytes())
    lines = tmp_path / EPISODES
    together, told = row["together"], row["coordination"]
    sooner = {**together, "makespan_s": 9.0, "schedule_score": 1.0}
    less = {**together, "orders": together["orders"][:-1]}
    forged: dict[str, Row] = {
        "": row,
        "makespan_s is 9.0": {**row, "together": sooner},
        "clearance_mm is 999.0": {
            **row,
            "coordination": {**told, "clearance_mm": 999.0},
        },
        "success": {**row, "together": less},
        "another way of acting": {n: v for n, v in row.items() if n != "together"},
    }
    assert tuple(forged) == FORGERIES
    write_rows(lines, [forged[what]])
    found = verify(lines, Serial())
    assert bool(found.problems) == bool(what)
    assert what in " ".join(found.problems)


@pytest.mark.slow
def test_turns_within_a_team_are_turns(tmp_path: Path) -> None:
    config = EvaluationConfig(
        out=tmp_path / "turns",
        policy=PolicySpec("greedy-reach"),
        tasks=("stack2",),
        episodes=1,
    )
    (turns,) = evaluate(config, Serial())
    (row,) = play(tmp_path / "team", "greedy-reach", "stack2", adapter="turns")
    assert "together" not in turns
    assert row["state_sha256"] == turns["state_sha256"]
    assert row["elapsed_s"] == turns["elapsed_s"]
    assert row["together"]["parallel_s"] == 0.0


@pytest.mark.slow
def test_a_turn_of_two_robots_keeps_both_busy(tmp_path: Path) -> None:
    config = EvaluationConfig(
        out=tmp_path, policy=PolicySpec("oracle"), tasks=("carry",), episodes=1
    )
    (row,) = evaluate(config, Serial())
    (step,) = row["subtasks"]
    assert "together" not in row
    assert {step["robot"], step["partner"]} == {"robot_0", "robot_1"}
    assert step["expert"]["pick_error_mm"] is None
    (scores,) = team_scores([row])
    assert scores.concurrency == pytest.approx(2.0)
    assert sum(scores.idle.values()) == pytest.approx(0.0)
    assert not verify(tmp_path / EPISODES, Serial()).problems


class Ordering(TeamPolicy):
    """Orders a plan as fast as robots become free; remembers what it was given."""

    blind = True

    def __init__(self, plan: Sequence[SubTask]) -> None:
        self.plan, self.seen = list(plan), list[TeamInput]()

    def act_together(self, inputs: Sequence[TeamInput]) -> list[list[SubTask]]:
        (given,) = inputs
        self.seen.append(given)
        orders = dict[str, SubTask]()
        for step in tuple(self.plan):
            if step.robot not in given.free or step.robot in orders:
                break
            orders[step.robot] = self.plan.pop(0)
        if not self.plan and not orders and not given.doing:
            return [[STOP]]
        return [list(orders.values())]


def test_a_team_policy_of_ones_own_orders_free_robots() -> None:
    policy = Ordering(plan_of("relay"))
    found = lemma.evaluate(policy, level="plan", tasks="relay", episodes=1)
    (row,) = found.rows
    assert row["success"]
    assert found.result.about["oracle"]
    assert found.result.about["policy"]["acting"] == "together"
    first, second, *_ = policy.seen
    assert first.free == ("robot_0", "robot_1", "robot_2")
    assert len(second.doing) + len(second.free) == 3
    ordered = [order["asked"] for order in row["together"]["orders"]]
    assert ordered == [0, 0, 0]


class Careless(Ordering):
    """Orders a robot that is at work."""

    def act_together(self, inputs: Sequence[TeamInput]) -> list[list[SubTask]]:
        (given,) = inputs
        busy = [doing.subtask for doing in given.doing.values()]
        return [busy] if busy else super().act_together(inputs)


def test_an_order_to_a_busy_robot_is_a_fault_that_ends_the_episode() -> None:
    policy = Careless(plan_of("relay"))
    (row,) = lemma.evaluate(policy, level="plan", tasks="relay", episodes=1).rows
    assert row["policy_error"]["kind"] == "malformed"
    assert "is busy" in row["policy_error"]["explanation"]
    # Those at work have finished.
    assert len(row["subtasks"]) >= 1


def test_the_first_refused_order_is_the_strict_end() -> None:
    plan = plan_of("relay")
    wrong = replace(plan[1], pick=plan[1].place, place=plan[1].pick)
    policy = Ordering([plan[0], wrong, *plan[1:]])
    (row,) = lemma.evaluate(policy, level="plan", tasks="relay", episodes=1).rows
    assert row["failure"] == "protective_stop"
    assert row["lenient"]["success"]
    assert [step["outcome"] for step in row["subtasks"]] == ["invalid"]


class Talking(RobotPolicy):
    """Knows its part of a plan; says when it has done a step, and hears of others."""

    def __init__(self) -> None:
        self.plan = plan_of("relay")
        self.seen: list[RobotInput] = []

    def act_alone(self, inputs: Sequence[RobotInput]) -> list[Choice]:
        return [self.choose(given) for given in inputs]

    def choose(self, given: RobotInput) -> Choice:
        self.seen.append(given)
        done = {step.subtask for step in given.past}
        said = [m.text for m in given.inbox]
        mine = [step for step in self.plan if step.robot == given.robot]
        todo = [step for step in mine if step not in done]
        if not todo:
            last = self.plan[-1].robot == given.robot
            news = "" if "done" in said or last else "done"
            return Choice(Decision(STOP, None) if last else None, news)
        before = self.plan[: self.plan.index(todo[0])]
        if before and len(said) < len(before):
            return Choice()
        return Choice(todo[0], f"{given.robot} goes")


@pytest.mark.slow
def test_robots_decide_alone_and_hear_each_other() -> None:
    policy = Talking()
    (row,) = lemma.evaluate(policy, level="plan", tasks="relay", episodes=1).rows
    assert row["success"]
    robots = {given.robot for given in policy.seen}
    assert robots == {"robot_0", "robot_1", "robot_2"}
    for given in policy.seen:
        assert given.view.joints.shape == (1, 6)
        assert all(message.robot != given.robot for message in given.inbox)
        assert all(step.subtask.robot == given.robot for step in given.past)
    texts = [message["text"] for message in row["together"]["messages"]]
    # The robot that is asked last has kept all that was said to it.
    assert [m.text for m in policy.seen[-1].inbox] == [
        text for text in texts if not text.startswith(policy.seen[-1].robot)
    ][: len(policy.seen[-1].inbox)]


def test_a_class_of_ones_own_acts_in_its_own_process(tmp_path: Path) -> None:
    spec = PolicySpec("team_policies:Waits+oracle", acting="together")
    config = EvaluationConfig(out=tmp_path, policy=spec, tasks=("relay",), episodes=1)
    (row,) = evaluate(config, Serial())
    assert row["policy_error"] is None
    assert row["together"]["asked"] == 2
    assert [m["text"] for m in row["together"]["messages"]] == [
        "robot_0 1",
        "robot_1 1",
        "robot_2 1",
    ]


def test_robots_take_turns_but_in_the_suite_of_teams() -> None:
    assert acting_by_default(["relay", "sort"]) == "together"
    assert acting_by_default(["relay"], controls=True) == "turns"
    assert acting_by_default(["relay", "stack"]) == "turns"
    with pytest.raises(InvalidConfigError, match="no act"):
        lemma.evaluate(Ordering([]), tasks="stack2", episodes=1)
    with pytest.raises(InvalidConfigError, match="Motor commands"):
        PolicySpec("oracle", level="control", acting="together")
