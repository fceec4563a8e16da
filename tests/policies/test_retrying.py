"""The rule for refused sub-tasks: another robot tries, until all were refused."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from lemma.core.poses import Pose2
from lemma.env.view import View
from lemma.motion.outcome import REFUSED, Outcome
from lemma.policies.compose import (
    MultiStep,
    PlannerWithGrounder,
    RetryingPlanner,
    RetryingPolicy,
)
from lemma.policies.interfaces import Decision, PastStep, PolicyInput
from lemma.policies.spec import PolicySpec
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

FIRST = SubTask("robot_0", Primitive.MOVE, "red_cube", "shared")
SECOND = SubTask("robot_1", Primitive.MOVE, "red_cube", "white_pad")
PLAN = (FIRST, SECOND, STOP)
VIEW = View(
    np.zeros((0, 0, 3), np.uint8),
    np.zeros((0, 0), np.float32),
    np.zeros((0, 0), np.bool_),
    np.zeros((0, 6)),
    np.zeros(0),
)


class ByHeart:
    """Plans by how many steps it is told of, whatever became of them."""

    def __init__(self) -> None:
        self.told: list[int] = []

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        self.told += [len(given.past) for given in inputs]
        return [PLAN[min(len(given.past), 2)] for given in inputs]

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        pose = Pose2(0.1, 0.2, 0.3)
        return [
            Decision(
                subtask,
                None
                if subtask == STOP
                else GroundedSubTask(subtask.robot, subtask.primitive, pose, pose),
            )
            for subtask in self.plan(inputs)
        ]


def given(*past: tuple[SubTask, str]) -> PolicyInput:
    steps = tuple(PastStep(VIEW, subtask, outcome) for subtask, outcome in past)
    return PolicyInput("Do it", ("red robot", "blue robot"), VIEW, steps)


def of(subtask: SubTask, robot: str) -> SubTask:
    return replace(subtask, robot=robot)


@pytest.mark.parametrize("outcome", sorted(REFUSED))
def test_another_robot_tries_what_one_was_refused(outcome: str) -> None:
    planner = RetryingPlanner(ByHeart())
    (again,) = planner.plan([given((FIRST, outcome))])
    assert again == of(FIRST, "robot_1")
    # It could: the plan goes on, and what was refused is not in it.
    past = given((FIRST, outcome), (again, "success"))
    assert RetryingPlanner(ByHeart()).plan([past]) == [STOP]


def test_the_planner_is_asked_as_if_it_had_not_been_tried() -> None:
    told = ByHeart()
    RetryingPlanner(told).plan(
        [given(), given((FIRST, "success"), (SECOND, "unreachable"))]
    )
    assert told.told == [0, 1]


def test_who_was_refused_with_every_robot_goes_on() -> None:
    told = ByHeart()
    other = of(FIRST, "robot_1")
    past = given((FIRST, "unreachable"), (other, "unreachable"))
    assert RetryingPlanner(told).plan([past]) == [STOP]
    assert told.told == [2]


def test_failures_of_motion_are_the_same_robots_to_mend() -> None:
    for outcome in set(Outcome) - REFUSED:
        found = RetryingPlanner(ByHeart()).plan([given((FIRST, outcome))])
        assert found == [SECOND]


def test_a_policy_of_one_level_keeps_its_poses() -> None:
    (found,) = RetryingPolicy(ByHeart()).act([given((FIRST, "unreachable"))])
    assert found.subtask == of(FIRST, "robot_1")
    assert found.grounded is not None
    assert found.grounded.robot == "robot_1"
    (plain,) = ByHeart().act([given()])
    assert plain.grounded is not None
    assert found.grounded.pick == plain.grounded.pick


@pytest.mark.parametrize("planning", ["single-step", "multi-step"])
@pytest.mark.parametrize("reads", [True, False, None])
def test_the_rule_is_for_who_does_not_read_outcomes(
    planning: str, reads: bool | None
) -> None:
    planner = ByHeart()
    planner.ground = None  # type: ignore[attr-defined]
    if reads is not None:
        planner.reads_outcomes = reads  # type: ignore[attr-defined]
    found = PolicySpec("mine:planner+oracle", planning).load(lambda _: planner)
    assert isinstance(found, PlannerWithGrounder)
    # Of a plan from the first view, nobody reads outcomes.
    wanted = reads is False or planning == "multi-step"
    assert isinstance(found.planner, RetryingPlanner) == wanted
    if planning == "multi-step":
        assert isinstance(found.planner, RetryingPlanner)
        assert isinstance(found.planner.planner, MultiStep)


def test_baselines_and_ours_are_told_apart_by_what_they_read() -> None:
    pytest.importorskip("torch")
    from lemma.policies.models.catalog import MODELS  # noqa: PLC0415

    assert {name for name in MODELS if MODELS[name][0].reads_outcomes} == {"reachnet"}
    policy = ByHeart()
    policy.reads_outcomes = False  # type: ignore[attr-defined]
    policy.plan = None  # type: ignore[method-assign, assignment]
    assert isinstance(PolicySpec("mine:policy").load(lambda _: policy), RetryingPolicy)
