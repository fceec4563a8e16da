"""Impossible sub-tasks end alike, for the same reason, wherever they are asked for."""

from collections.abc import Sequence
from typing import Any

import pytest

import lemma
from lemma.evaluation.run.rollout import Player, Rollout, TakenStep, roll_out
from lemma.expert.plan_env import PlanEnv
from lemma.policies.compose import PlannerWithGrounder
from lemma.policies.interfaces import Grounder, PolicyInput
from lemma.policies.oracle import OracleGrounder
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

MOVE, HOOK = Primitive.MOVE, Primitive.HOOK
IMPOSSIBLE = {
    "fixed": SubTask("robot_0", MOVE, "PAD", "shared"),
    "absent": SubTask("robot_0", MOVE, "ABSENT", "shared"),
    "onto itself": SubTask("robot_0", MOVE, "CUBE", "CUBE"),
    "by cube": SubTask("robot_0", HOOK, "CUBE", "CUBE"),
    "too early": SubTask("robot_0", HOOK, "stick", "CUBE"),
    "too far": SubTask("FAR", MOVE, "CUBE", "shared"),
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


def evaluated(subtask: SubTask, grounder: Grounder) -> tuple[TakenStep, PolicyInput]:
    """Return the step of `lemma evaluate`, and what the policy is told after it."""
    planner = Once(subtask)
    player = Player(PlannerWithGrounder(planner, grounder))
    instance = lemma.load_instance("hook", "test", 0)
    [play] = roll_out([Rollout(instance)], player)
    [step] = play.steps
    return step, planner.given[-1]


def at_plan_level(subtask: SubTask) -> dict[str, Any]:
    env = lemma.make("hook", level="plan", split="test", index=0)
    assert isinstance(env, PlanEnv)
    env.reset()
    return env.step(env.encode(subtask))[4]


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


@pytest.mark.parametrize("subtask", IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_evaluation_says_what_the_plan_level_says(subtask: SubTask) -> None:
    wanted = in_scene(subtask)
    said = at_plan_level(wanted)
    step, after = evaluated(wanted, OracleGrounder())
    assert step.grounded is None
    assert str(step.result.outcome) == said["outcome"] != "success"
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
