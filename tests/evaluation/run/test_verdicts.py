"""Protocol 2: the strict episode is a prefix of the lenient one, and hears of none."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiers import slow_but

import lemma
from lemma.core.errors import DatasetError
from lemma.core.poses import Pose2
from lemma.core.workers.pool import Serial
from lemma.evaluation.protocol.rules import REFUSAL_S
from lemma.evaluation.records import PROTECTIVE_STOP, Row
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.evaluation.run.replay import differences, play_again
from lemma.evaluation.run.rollout import Player, Rollout, StepRecord, roll_out
from lemma.expert.plan_env import PlanEnv
from lemma.policies.compose import PlannerWithGrounder
from lemma.policies.interfaces import (
    Decision,
    Grounder,
    Oracle,
    OracleInput,
    PolicyInput,
)
from lemma.policies.oracle import OracleGrounder, OraclePlanner
from lemma.policies.spec import PolicySpec
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import load_instance

EPISODES = 3


class Fickle(Oracle):
    """The expert, but: its poses depend on the company of the batch, by 0.1 mm each.

    It also sends the wrong robot first in all episodes but the first, and in the last
    one again and again.
    """

    def __init__(self) -> None:
        self._planner, self._grounder = OraclePlanner(), OracleGrounder()

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return [self._decide(given, len(inputs)) for given in inputs]

    def _decide(self, given: PolicyInput, company: int) -> Decision:
        assert isinstance(given, OracleInput)
        index = given.episode.instance.index
        (subtask,) = self._planner.plan([given])
        if subtask == STOP:
            return Decision(STOP, None)
        if index == 2 or (index == 1 and not given.past):
            other = {"robot_0": "robot_1", "robot_1": "robot_0"}[subtask.robot]
            return Decision(replace(subtask, robot=other), None)
        (grounded,) = self._grounder.ground([given], [subtask])
        assert grounded is not None
        pick = grounded.pick
        moved = Pose2(pick.x + 1e-4 * company, pick.y, pick.yaw)
        return Decision(subtask, replace(grounded, pick=moved))


def order(out: Path, verdicts: str) -> EvaluationConfig:
    return EvaluationConfig(
        out=out,
        policy=PolicySpec("test_verdicts:Fickle", timeout_s=0.0),
        tasks=("stack",),
        split="val",
        episodes=EPISODES,
        verdicts=verdicts,
    )


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    return evaluate(order(tmp_path_factory.mktemp("both"), "both"), Serial())


@pytest.mark.slow
def test_strictly_alone_gives_the_same_strict_lines(
    tmp_path: Path, played: list[Row]
) -> None:
    strict = evaluate(order(tmp_path, "strict"), Serial())
    assert [row["lenient"] for row in strict] == [None] * EPISODES
    free = ("wall_s", "lenient")
    for one, both in zip(strict, played, strict=True):
        assert {k: v for k, v in one.items() if k not in free} == {
            k: v for k, v in both.items() if k not in free
        }


def test_the_first_refused_sub_task_ends_the_strict_episode(played: list[Row]) -> None:
    solved, retried, lost = played
    assert solved["success"]
    assert solved["lenient"]["success"]
    assert solved["lenient"]["subtasks"] == []
    for row in (retried, lost):
        assert (row["success"], row["failure"]) == (False, PROTECTIVE_STOP)
        assert row["subtasks"][-1]["outcome"] == "unreachable"
        assert all(step["outcome"] == "success" for step in row["subtasks"][:-1])


def test_told_of_it_a_policy_may_still_succeed_for_its_price(played: list[Row]) -> None:
    solved, retried, lost = played
    assert retried["lenient"]["success"]
    assert retried["lenient"]["failure"] is None
    assert retried["lenient"]["subtasks"][0]["start_s"] == REFUSAL_S
    assert retried["elapsed_s"] < REFUSAL_S < retried["lenient"]["elapsed_s"]
    assert solved["elapsed_s"] == solved["lenient"]["elapsed_s"]
    # Refused until the time is over, each time for the whole price.
    assert lost["lenient"]["failure"] == "out_of_time"
    assert len(lost["lenient"]["subtasks"]) == 100.0 / REFUSAL_S - 1
    starts = [step["start_s"] for step in lost["lenient"]["subtasks"]]
    due = [REFUSAL_S * (i + 1) for i in range(len(starts))]
    assert starts == pytest.approx(due, abs=0.1)


def test_what_is_counted_is_of_the_strict_episode(played: list[Row]) -> None:
    retried = played[1]
    assert retried["coordination"]["doable"] == len(retried["subtasks"]) == 1
    assert retried["coordination"]["able"] == 0
    assert retried["left"] == retried["subtasks"][0]["expert"]["left"]


@pytest.mark.parametrize("strictly", slow_but([True, False], True))
def test_episodes_played_again_are_equal(played: list[Row], strictly: bool) -> None:
    for row in played:
        instance = load_instance("stack", "val", row["index"])
        again = play_again(row, instance, {"horizon_s": 100.0}, strictly=strictly)
        assert list(differences(row, again, strictly=strictly)) == []


def test_one_folder_holds_one_sort_of_verdicts(tmp_path: Path) -> None:
    short = replace(order(tmp_path, "strict"), episodes=1)
    evaluate(short, Serial())
    assert short.command().endswith("--protocol strict")
    with pytest.raises(DatasetError, match="verdicts"):
        evaluate(replace(short, verdicts="both"), Serial())


class Wrong(Oracle):
    """Sends the other robot first, and does not read that it was refused."""

    reads_outcomes = False

    def __init__(self) -> None:
        self._planner = OraclePlanner()

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        found = []
        for given in inputs:
            (subtask,) = self._planner.plan([given])
            if subtask != STOP and not given.past:
                other = {"robot_0": "robot_1", "robot_1": "robot_0"}[subtask.robot]
                subtask = replace(subtask, robot=other)
            found.append(subtask)
        return found


def test_the_rule_lets_another_robot_try() -> None:
    policy = PolicySpec("mine:wrong+oracle").load(lambda _: Wrong())
    assert isinstance(policy, PlannerWithGrounder)
    (play,) = roll_out([Rollout(load_instance("stack", "val", 0))], Player(policy))
    assert not play.success
    assert play.failure == PROTECTIVE_STOP
    assert play.verdict().success
    robots = [step.subtask.robot for step in play.steps[:2]]
    assert sorted(robots) == ["robot_0", "robot_1"]
    assert play.steps[0].subtask.pick == play.steps[1].subtask.pick


MOVE, HOOK = Primitive.MOVE, Primitive.HOOK
IMPOSSIBLE = {
    "fixed": (SubTask("robot_0", MOVE, "PAD", "shared"), "fixed"),
    "absent": (SubTask("robot_0", MOVE, "ABSENT", "shared"), "no "),
    "onto itself": (SubTask("robot_0", MOVE, "CUBE", "CUBE"), "cannot"),
    "by cube": (SubTask("robot_0", HOOK, "CUBE", "CUBE"), "stick"),
    "too early": (SubTask("robot_0", HOOK, "stick", "CUBE"), "prehook"),
    "too far": (SubTask("FAR", MOVE, "CUBE", "shared"), "reach"),
}


class Once:
    """Plans one sub-task, then stops; remembers what it was given."""

    def __init__(self, subtask: SubTask) -> None:
        self.subtask = subtask
        self.given: list[PolicyInput] = []

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        self.given += inputs
        return [STOP if given.past else self.subtask for given in inputs]


class Helpless:
    """Finds no pose for anything."""

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        return [None for _ in inputs]


def evaluated(subtask: SubTask, grounder: Grounder) -> tuple[StepRecord, PolicyInput]:
    """Return the step of `lemma evaluate`, and what the policy is told after it."""
    planner = Once(subtask)
    player = Player(PlannerWithGrounder(planner, grounder))
    instance = lemma.load_instance("hook", "test", 0)
    [play] = roll_out([Rollout(instance)], player)
    [step] = play.steps
    return step, planner.given[-1]


def at_plan_level(subtask: SubTask) -> dict[str, Any]:
    """Return what is said of a sub-task that changes nothing and earns nothing."""
    env = lemma.make("hook", level="plan", split="test", index=0)
    assert isinstance(env, PlanEnv)
    _, before = env.reset()
    _, *earned, info = env.step(env.encode(subtask))
    assert earned == [0.0, False, False]
    for name, pose in before["state"].items():
        assert np.allclose(info["state"][name], pose, atol=1e-4)
    assert env.step(env.encode(STOP))[4]["failure"] == "goal_not_reached"
    return info


def in_scene(subtask: SubTask) -> SubTask:
    """Return a sub-task with the cube and the pad of the instance."""
    instance = lemma.load_instance("hook", "test", 0)
    ((cube, pad),) = instance.goal.pairs
    plan = lemma.Expert(lemma.Episode(instance).simulation.scene, instance.goal).plan()
    assert plan is not None
    # The last robot lifts the cube, which the first one cannot do yet.
    names = {"CUBE": cube, "PAD": pad, "FAR": plan.steps[-1].subtask.robot}
    names["ABSENT"] = next(e for e in ENTITIES if e not in instance.scene.object_names)
    return SubTask(
        names.get(subtask.robot, subtask.robot),
        subtask.primitive,
        names.get(subtask.pick, subtask.pick),
        names.get(subtask.place, subtask.place),
    )


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_evaluation_says_what_the_plan_level_says(case: str) -> None:
    subtask, words = IMPOSSIBLE[case]
    wanted = in_scene(subtask)
    said = at_plan_level(wanted)
    assert said["outcome"] == ("unreachable" if case == "too far" else "invalid")
    assert words in said["explanation"]
    step, after = evaluated(wanted, OracleGrounder())
    assert step.grounded is None
    assert str(step.result.outcome) == said["outcome"]
    assert step.result.explanation == said["explanation"]
    [past] = after.past
    assert (past.outcome, past.explanation) == (said["outcome"], said["explanation"])


def test_what_could_be_done_is_the_grounders_fault() -> None:
    instance = lemma.load_instance("hook", "test", 0)
    scene = lemma.Episode(instance).simulation.scene
    plan = lemma.Expert(scene, instance.goal).plan()
    assert plan is not None
    first = plan.steps[0].subtask
    step, _ = evaluated(first, Helpless())
    assert str(step.result.outcome) == "invalid"
    assert step.result.explanation == f"No pose was found for: {first}."
    step, after = evaluated(first, OracleGrounder())
    assert step.result.ok
    assert (after.past[0].outcome, after.past[0].explanation) == ("success", "")
