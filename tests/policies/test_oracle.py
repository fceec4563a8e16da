"""The expert as planner, grounder and allocator: right, repeatable, and privileged."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
from tiers import slow_but

from lemma.core.errors import InvalidConfigError
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.compose import PlannerWithGrounder
from lemma.policies.interfaces import Oracle, PolicyInput
from lemma.policies.oracle import (
    GroundTruthAllocation,
    OracleGrounder,
    OraclePlanner,
)
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.suite import SUITE, load_instance


class Swaps(Oracle):
    """Gives every sub-task of the expert to the other robot."""

    def __init__(self) -> None:
        self.expert = OraclePlanner()

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        other = {"robot_0": "robot_1", "robot_1": "robot_0", "": ""}
        return [replace(s, robot=other[s.robot]) for s in self.expert.plan(inputs)]


@pytest.mark.parametrize("task", slow_but(SUITE, "hook"))
def test_the_oracle_solves_and_stops(task: str) -> None:
    player = Player(PlannerWithGrounder(OraclePlanner(), OracleGrounder()))
    [play] = roll_out([Rollout(load_instance(task, "test", 1))], player)
    assert play.episode.is_success
    assert play.episode.stopped
    assert [step.result.outcome for step in play.steps] == ["success"] * len(play.steps)


@pytest.mark.parametrize("task", slow_but(("pass2", "hook_stack"), "pass2"))
def test_right_allocation_mends_a_planner_that_errs_in_it_alone(task: str) -> None:
    instance = load_instance(task, "test", 2)
    wrong = PlannerWithGrounder(Swaps(), OracleGrounder())
    mended = PlannerWithGrounder(GroundTruthAllocation(Swaps()), OracleGrounder())
    [failed] = roll_out([Rollout(instance, horizon_s=20.0)], Player(wrong))
    [solved] = roll_out([Rollout(instance)], Player(mended))
    assert not failed.episode.is_success
    assert solved.episode.is_success


def test_the_same_question_has_the_same_answer() -> None:
    play = Rollout(load_instance("stack", "test", 0))
    planner = OraclePlanner()
    inputs = [play.policy_input(None, planner)]
    first = planner.plan(inputs)
    assert planner.plan(inputs) == first
    assert OraclePlanner().plan(inputs) == first


def test_what_no_robot_can_do_stays_with_the_planner() -> None:
    class Wants:
        def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
            return [SubTask("robot_1", Primitive.HOOK, "stick", "no_cube")]

    play = Rollout(load_instance("stack", "test", 0))
    mended = GroundTruthAllocation(Wants())
    [subtask] = mended.plan([play.policy_input(None, mended)])
    assert subtask.robot == "robot_1"


def test_oracles_need_the_truth() -> None:
    play = Rollout(load_instance("stack", "test", 0))
    blind = play.policy_input(None)
    with pytest.raises(InvalidConfigError, match="learned policy"):
        OraclePlanner().plan([blind])
    subtask = OraclePlanner().plan([play.policy_input(None, OraclePlanner())])[0]
    with pytest.raises(InvalidConfigError, match="learned policy"):
        OracleGrounder().ground([blind], [subtask])
