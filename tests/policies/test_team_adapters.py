"""Adapters: which orders a sequential policy gives to free robots."""

from collections.abc import Sequence

import numpy as np
import pytest

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.env.view import View
from lemma.policies.interfaces import Decision, PastStep, PolicyInput
from lemma.policies.spec import PolicySpec
from lemma.policies.together.adapters import Greedy, Turns, WithExpertPoses
from lemma.policies.together.each_asked import EachAsked
from lemma.policies.together.interfaces import (
    Choice,
    Doing,
    Message,
    RobotInput,
    TeamInput,
)
from lemma.policies.together.loading import team_of
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

VIEW = View(
    np.zeros((0, 0, 3), np.uint8),
    np.zeros((0, 0), np.float32),
    np.zeros((0, 0), np.bool_),
    np.zeros((2, 6)),
    np.zeros(2),
)
RED = SubTask("robot_0", Primitive.MOVE, "red_cube", "shared")
BLUE = SubTask("robot_1", Primitive.MOVE, "blue_cube", "shared")
ON_RED = SubTask("robot_1", Primitive.MOVE, "red_cube", "blue_pad")
AGAIN = SubTask("robot_0", Primitive.MOVE, "green_cube", "shared")


def posed(subtask: SubTask) -> Decision:
    if subtask.primitive is Primitive.STOP:
        return Decision(STOP, None)
    at = Pose2(0.0, 0.0)
    poses = GroundedSubTask(subtask.robot, subtask.primitive, at, at)
    return Decision(subtask, poses)


class Follows:
    """Goes on in a list by what the past says is done."""

    def __init__(self, *plan: SubTask) -> None:
        self.plan = plan

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return [posed((*self.plan, STOP)[len(given.past)]) for given in inputs]


def team(*doing: SubTask, done: tuple[SubTask, ...] = ()) -> TeamInput:
    busy = {one.robot: Doing(one, 1.0) for one in doing}
    return TeamInput(
        "Do it",
        ("red robot", "white robot"),
        VIEW,
        tuple(PastStep(VIEW, one) for one in done),
        time_s=2.0,
        free=tuple(name for name in ("robot_0", "robot_1") if name not in busy),
        doing=busy,
    )


@pytest.mark.parametrize(
    ("plan", "given", "ordered"),
    [
        # One for each free robot.
        ((RED, BLUE), team(), [RED, BLUE]),
        # Only as long as the next is for a free robot.
        ((RED, AGAIN, BLUE), team(), [RED]),
        ((RED, AGAIN, BLUE), team(RED), []),
        # Poses of a cube that is under way are those of where it was.
        ((RED, ON_RED), team(), [RED]),
        ((RED, ON_RED), team(RED), []),
        ((RED, ON_RED), team(done=(RED,)), [ON_RED]),
        # A sub-task is done again when nobody is at work, if at all.
        ((BLUE, RED, BLUE), team(RED, done=(BLUE,)), []),
        ((BLUE, BLUE), team(done=(BLUE,)), [BLUE]),
        # It stops when nobody is at work.
        ((RED,), team(RED), []),
        ((RED,), team(done=(RED,)), [STOP]),
    ],
)
def test_greedy_orders_what_is_valid_for_free_robots(
    plan: tuple[SubTask, ...], given: TeamInput, ordered: list[SubTask]
) -> None:
    (found,) = Greedy(Follows(*plan)).act_together([given])
    assert [one.subtask for one in found.decisions] == ordered


def test_a_planner_whose_poses_come_later_orders_what_depends_on_others() -> None:
    (found,) = Greedy(Follows(RED, ON_RED), symbolic=True).act_together([team()])
    assert [one.subtask for one in found.decisions] == [RED, ON_RED]


def test_turns_order_one_sub_task_when_nobody_is_at_work() -> None:
    found = Turns(Follows(RED, BLUE)).act_together([team(), team(RED)])
    assert [[one.subtask for one in each.decisions] for each in found] == [[RED], []]


class Answers:
    """Gives each robot one answer, whatever it is."""

    def __init__(self, **answers: object) -> None:
        self.answers, self.inboxes = answers, dict[str, list[str]]()

    def act_alone(self, inputs: Sequence[RobotInput]) -> list[object]:
        for given in inputs:
            self.inboxes[given.robot] = [one.text for one in given.inbox]
        return [self.answers[given.robot] for given in inputs]


def test_a_message_reaches_those_that_are_asked_later() -> None:
    policy = Answers(robot_0=Choice(RED, "red is mine"), robot_1=BLUE)
    given = TeamInput(
        "Do it",
        ("red robot", "white robot"),
        VIEW,
        time_s=2.0,
        free=("robot_0", "robot_1"),
        messages=(Message("robot_1", "hello", 0.5),),
        own_views={"robot_0": VIEW, "robot_1": VIEW},
    )
    (found,) = EachAsked(policy).act_together([given])  # type: ignore[arg-type]
    assert [one.subtask for one in found.decisions] == [RED, BLUE]
    assert found.messages == (Message("robot_0", "red is mine", 2.0),)
    assert policy.inboxes == {"robot_0": ["hello"], "robot_1": ["red is mine"]}
    for wrong in (Choice(BLUE), Choice(message="x" * 201)):
        policy.answers["robot_0"] = wrong
        with pytest.raises(ValueError, match=r"itself alone|200 characters"):
            EachAsked(policy).act_together([given])  # type: ignore[arg-type]


class InSymbols:
    symbolic = True

    def act_together(self, inputs: Sequence[TeamInput]) -> list[list[SubTask]]:
        return [[RED] for _ in inputs]


def test_a_policy_that_never_gives_poses_is_not_played_without_a_grounder() -> None:
    def load(name: str) -> InSymbols:
        return InSymbols()

    with pytest.raises(InvalidConfigError, match=r"mine:It\+oracle"):
        team_of(PolicySpec("mine:It"), load)
    team = team_of(PolicySpec("mine:It+oracle"), load)
    assert isinstance(team, WithExpertPoses)
