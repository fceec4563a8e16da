"""Policies of two parts: who is asked what, and who answers."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from faulty_policies import MOVE, given, view

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.evaluation.run.loading import learned_parts
from lemma.motion.outcome import REFUSED, Outcome
from lemma.policies.compose import (
    MultiStep,
    PlannerWithGrounder,
    RetryingPlanner,
    RetryingPolicy,
)
from lemma.policies.interfaces import Decision, PastStep, Policy, PolicyInput
from lemma.policies.spec import PolicySpec, parts_of
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

FIRST = SubTask("robot_0", Primitive.MOVE, "red_cube", "shared")
SECOND = SubTask("robot_1", Primitive.MOVE, "red_cube", "white_pad")
PLAN = (FIRST, SECOND, STOP)


class StopsAt:
    """Plans to stop where the instruction is "stop"."""

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        return [STOP if i.instruction == "stop" else MOVE for i in inputs]


class Remembers:
    """Grounds nothing that is called "lost", and keeps what it was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        self.asked += [i.instruction for i in inputs]
        return [
            None
            if i.instruction == "lost"
            else GroundedSubTask(s.robot, s.primitive, Pose2(0, 0, 0), Pose2(1, 0, 0))
            for i, s in zip(inputs, subtasks, strict=True)
        ]


def test_only_those_that_go_on_are_grounded() -> None:
    grounder = Remembers()
    policy = PlannerWithGrounder(StopsAt(), grounder)
    inputs = [given("go"), given("stop"), given("lost"), given("go")]
    decisions = policy.act(inputs)
    assert grounder.asked == ["go", "lost", "go"]
    assert [d.stops for d in decisions] == [False, True, False, False]
    assert [d.grounded is None for d in decisions] == [False, True, True, False]
    assert "red_cube" in decisions[2].explanation


def test_multi_step_sees_the_first_view_alone() -> None:
    seen: list[PolicyInput] = []

    class Sees(StopsAt):
        def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
            seen.extend(inputs)
            return super().plan(inputs)

    past = (PastStep(view(1), MOVE, "dropped"), PastStep(view(2), MOVE))
    MultiStep(Sees()).plan([given("go", *past), given("go")])
    first = past[0].view
    assert seen[0].view is first
    assert [step.view for step in seen[0].past] == [first, first]
    assert {step.outcome for step in seen[0].past} == {"success"}
    assert seen[1].view.rgb[0, 0, 0] == 9


def test_words_name_the_robot_as_people_do() -> None:
    words = given().words_for(replace(MOVE, robot="robot_1"))
    assert words == "white robot: move the red cube onto the blue pad"
    assert given().words_for(STOP) == "done"


def test_specification_names_policies() -> None:
    assert PolicySpec().blind
    assert PolicySpec("oracle+oracle").blind
    assert not PolicySpec("oracle+cliport").blind
    for planning in ("single-step", "multi-step"):
        for gta in (False, True):
            assert isinstance(PolicySpec("oracle", planning, gta).load(), Policy)


def test_specification_refuses_what_is_no_policy() -> None:
    with pytest.raises(UnknownNameError, match="single-step, multi-step"):
        PolicySpec(planning="never")
    with pytest.raises(InvalidConfigError, match="mypackage"):
        PolicySpec("no_such_module:Policy").load()
    with pytest.raises(InvalidConfigError, match="no act"):
        PolicySpec("collections:Counter").load()
    with pytest.raises(InvalidConfigError, match="no plan"):
        PolicySpec("collections:Counter+oracle").load()
    with pytest.raises(InvalidConfigError, match="no ground"):
        PolicySpec("oracle+collections:Counter").load()


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("reachnet", ["reachnet"]),
        ("episodic-transformer+cliport", ["episodic-transformer", "cliport"]),
        ("runs/mine+cliport", ["runs/mine", "cliport"]),
        ("runs/a/et+runs/a/cliport", ["runs/a/et", "runs/a/cliport"]),
        ("/none/et+/none/cliport", ["/none/et", "/none/cliport"]),
        ("nonsense+cliport", ["nonsense", "cliport"]),
        ("cliport+nonsense", ["cliport", "nonsense"]),
        ("no+sense", ["no", "sense"]),
        ("/none/c++/weights.safetensors", ["/none/c++/weights.safetensors"]),
        ("{here}/c++/w", ["{here}/c++/w"]),
        ("{here}/c++/w+cliport", ["{here}/c++/w", "cliport"]),
        ("{here}/c++/w+{here}/c++/w", ["{here}/c++/w", "{here}/c++/w"]),
        ("lerobot:/data/a+b", ["lerobot:/data/a+b"]),
        ("llm:gpt-x", ["llm:gpt-x"]),
        ("llm:gpt-x+search", ["llm:gpt-x+search"]),
        ("llm:gpt-x+search+cliport", ["llm:gpt-x+search", "cliport"]),
        ("llm:a:7b+oracle", ["llm:a:7b", "oracle"]),
        ("my.module:Class+oracle", ["my.module:Class", "oracle"]),
        ("http://127.0.0.1:80+my:Class", ["http://127.0.0.1:80", "my:Class"]),
    ],
)
def test_a_plus_sign_joins_planner_and_grounder_alone(
    tmp_path: Path, name: str, parts: list[str]
) -> None:
    (tmp_path / "c++").mkdir()
    (tmp_path / "c++/w").touch()
    wanted = tuple(part.format(here=tmp_path) for part in parts)
    assert parts_of(name.format(here=tmp_path)) == wanted
    # So it is for what evaluates them, too.
    assert set(learned_parts(name.format(here=tmp_path))) <= set(wanted)


# --- Refused sub-tasks: another robot tries, until all were refused ---------------


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
            Decision(one, GroundedSubTask(one.robot, one.primitive, pose, pose))
            for one in self.plan(inputs)
        ]


def after(*past: tuple[SubTask, str]) -> PolicyInput:
    steps = (PastStep(view(), subtask, outcome) for subtask, outcome in past)
    return given("Do it", *steps)


def of(subtask: SubTask, robot: str) -> SubTask:
    return replace(subtask, robot=robot)


@pytest.mark.parametrize("outcome", sorted(REFUSED))
def test_another_robot_tries_what_one_was_refused(outcome: str) -> None:
    planner = RetryingPlanner(ByHeart())
    (again,) = planner.plan([after((FIRST, outcome))])
    assert again == of(FIRST, "robot_1")
    # It could: the plan goes on, and what was refused is not in it.
    past = after((FIRST, outcome), (again, "success"))
    assert RetryingPlanner(ByHeart()).plan([past]) == [STOP]


def test_the_planner_is_asked_as_if_it_had_not_been_tried() -> None:
    told = ByHeart()
    RetryingPlanner(told).plan(
        [after(), after((FIRST, "success"), (SECOND, "unreachable"))]
    )
    assert told.told == [0, 1]


def test_who_was_refused_with_every_robot_goes_on() -> None:
    told = ByHeart()
    other = of(FIRST, "robot_1")
    past = after((FIRST, "unreachable"), (other, "unreachable"))
    assert RetryingPlanner(told).plan([past]) == [STOP]
    assert told.told == [2]


def test_failures_of_motion_are_the_same_robots_to_mend() -> None:
    for outcome in set(Outcome) - REFUSED:
        found = RetryingPlanner(ByHeart()).plan([after((FIRST, outcome))])
        assert found == [SECOND]


def test_a_policy_of_one_level_keeps_its_poses() -> None:
    (found,) = RetryingPolicy(ByHeart()).act([after((FIRST, "unreachable"))])
    assert found.subtask == of(FIRST, "robot_1")
    assert found.grounded is not None
    assert found.grounded.robot == "robot_1"
    (plain,) = ByHeart().act([after()])
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

    assert {name for name in MODELS if MODELS[name][0].reads_outcomes} == {
        "reachnet",
        "team-reachnet",
    }
    policy = ByHeart()
    policy.reads_outcomes = False  # type: ignore[attr-defined]
    policy.plan = None  # type: ignore[method-assign, assignment]
    assert isinstance(PolicySpec("mine:policy").load(lambda _: policy), RetryingPolicy)
