"""One cause for every failure, by what the expert would have done."""

from collections.abc import Sequence
from typing import Any

import pytest
from made_up import row, step

from lemma.env.episode import Episode
from lemma.evaluation.analysis.failure_causes import Cause, cause_of
from lemma.evaluation.records import Deviation
from lemma.evaluation.run.expert_feedback import advise, deviation, left_in
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.interfaces import Decision, Oracle, PolicyInput
from lemma.policies.oracle import OracleGrounder, OraclePlanner
from lemma.policies.spec import PolicySpec
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import load_instance

FIRST = SubTask("robot_0", Primitive.MOVE, "red_cube", "shared")
SECOND = SubTask("robot_1", Primitive.MOVE, "red_cube", "white_pad")
PLAN = (FIRST, SECOND)


def test_success_has_no_cause() -> None:
    assert cause_of(row(success=True)) is None


@pytest.mark.parametrize(
    ("steps", "left", "cause"),
    [
        ([step(2, "robot")], 2, Cause.WRONG_ROBOT),
        ([step(2, "order", "unreachable")], 2, Cause.WRONG_ORDER),
        ([step(2, "primitive")], 2, Cause.WRONG_PRIMITIVE),
        ([step(2, "object")], 2, Cause.WRONG_OBJECT),
        ([step(2, "", "nothing_to_pick", 35.0)], 2, Cause.MISSED_PICK),
        ([step(2, "", "nothing_to_pick", 3.0)], 2, Cause.EXECUTION),
        ([step(2, "", "invalid")], 2, Cause.MISSED_PICK),
        ([step(2, "", "success", 3.0, 35.0)], 2, Cause.MISSED_PLACE),
        ([step(2, "", "success", 3.0, 5.0)], 2, Cause.EXECUTION),
        ([step(2, "", "success")], 2, Cause.MISSED_PLACE),
        ([step(2, "", "dropped", 3.0)], 2, Cause.EXECUTION),
        ([step(2, "", "out_of_time")], 2, Cause.OUT_OF_TIME),
        ([step(2)], 1, Cause.STOPPED_EARLY),
        ([], 2, Cause.STOPPED_EARLY),
        ([step(1)], 0, Cause.EXECUTION),
    ],
)
def test_one_cause(steps: list[dict[str, Any]], left: int, cause: Cause) -> None:
    assert cause_of(row(steps=steps, left=left)) is cause


def test_what_falls_is_a_cause_unless_somebody_else_should_have_done_it() -> None:
    fatal = {**step(2, "", "dropped", 3.0, 35.0), "fell": ["red_cube"]}
    assert cause_of(row(steps=[fatal], left=None)) is Cause.FELL
    wrong = {**step(2, "robot", "dropped"), "fell": ["red_cube"]}
    assert cause_of(row(steps=[wrong], left=None)) is Cause.WRONG_ROBOT


def test_a_protective_stop_is_a_mistake_with_a_cause_of_its_own() -> None:
    def stopped(*steps: dict[str, Any]) -> dict[str, Any]:
        return row(steps=steps, left=2, failure="protective_stop")

    assert cause_of(stopped(step(2, "robot", "unreachable"))) is Cause.WRONG_ROBOT
    missed = step(2, "", "nothing_to_pick", 35.0)
    assert cause_of(stopped(step(3), missed)) is Cause.MISSED_PICK
    # An earlier sub-task that lost ground is the mistake.
    assert cause_of(stopped(step(2, "object"), missed)) is Cause.WRONG_OBJECT


def test_what_helps_is_no_mistake_whatever_the_expert_would_do() -> None:
    steps = [step(4, "object"), step(3, "", "missed_grasp", 30.0)]
    assert cause_of(row(steps=steps, left=3)) is Cause.MISSED_PICK


def test_what_was_made_good_is_not_the_cause() -> None:
    steps = [step(2, "robot"), step(2), step(1, "object")]
    assert cause_of(row(steps=steps, left=1)) is Cause.WRONG_OBJECT


def test_the_first_mistake_that_stays_is_the_cause() -> None:
    # The second one made it worse: no plan is left.
    steps = [step(2, "robot"), step(2, "object"), step(None, "primitive")]
    assert cause_of(row(steps=steps, left=None)) is Cause.WRONG_ROBOT


def test_no_mistake_but_too_slow() -> None:
    late = row(steps=[step(3), step(2)], left=1, failure="out_of_time")
    assert cause_of(late) is Cause.OUT_OF_TIME


@pytest.mark.parametrize(
    ("subtask", "expected"),
    [
        (FIRST, Deviation.NONE),
        (SECOND, Deviation.ORDER),
        (SubTask("robot_1", Primitive.MOVE, "red_cube", "shared"), Deviation.ROBOT),
        (SubTask("robot_0", Primitive.MOVE, "red_cube", "white_pad"), Deviation.ROBOT),
        (SubTask("robot_0", Primitive.HOOK, "stick", "red_cube"), Deviation.PRIMITIVE),
        (SubTask("robot_0", Primitive.MOVE, "blue_cube", "shared"), Deviation.OBJECT),
    ],
)
def test_departures(subtask: SubTask, expected: Deviation) -> None:
    assert deviation(subtask, PLAN) is expected


def test_to_act_where_all_is_done_is_a_wrong_primitive() -> None:
    assert deviation(FIRST, ()) is Deviation.PRIMITIVE


class Clumsy(Oracle):
    """The expert, whose poses are off by 40 mm."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        subtasks = OraclePlanner().plan(inputs)
        return [
            self._decide(given, s) for given, s in zip(inputs, subtasks, strict=True)
        ]

    def _decide(self, given: PolicyInput, subtask: SubTask) -> Decision:
        if subtask == STOP or given.past:
            return Decision(STOP, None)
        grounded = OracleGrounder().ground([given], [subtask])[0]
        assert grounded is not None
        return Decision(subtask, moved(grounded))


def moved(grounded: GroundedSubTask) -> GroundedSubTask:
    pick = grounded.pick
    off = type(pick)(pick.x + 0.04, pick.y, pick.yaw)
    return GroundedSubTask(grounded.robot, grounded.primitive, off, grounded.place)


def test_the_expert_is_asked_while_an_episode_is_played() -> None:
    play = Rollout(load_instance("stack", "val", 0))
    (over,) = roll_out([play], Player(Clumsy()))
    (taken,) = over.steps
    assert taken.advice.left == 2
    assert taken.advice.departure is Deviation.NONE
    assert taken.advice.pick_error_mm == pytest.approx(40.0)
    assert taken.advice.place_error_mm is None


def test_the_expert_agrees_with_itself_to_the_end() -> None:
    play = Rollout(load_instance("hook", "val", 0))
    (over,) = roll_out([play], Player.load(PolicySpec()))
    assert [taken.advice.left for taken in over.steps] == [4, 3, 2, 1]
    assert {taken.advice.departure for taken in over.steps} == {Deviation.NONE}
    assert left_in(over.episode) == 0


def test_asking_changes_nothing() -> None:
    episode = Episode(load_instance("hook_stack", "val", 1))
    before = episode.simulation.snapshot()
    advice = advise(episode, Decision(FIRST, None))
    assert advice.left == 7
    after = episode.simulation.snapshot()
    assert repr(before) == repr(after)
