"""Policies of two parts: who is asked what, and who answers."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.env.view import View
from lemma.evaluation.run.loading import learned_parts
from lemma.policies.compose import MultiStep, PlannerWithGrounder
from lemma.policies.interfaces import (
    Grounder,
    PastStep,
    Planner,
    Policy,
    PolicyInput,
)
from lemma.policies.spec import PolicySpec, parts_of
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

MOVE = SubTask("robot_0", Primitive.MOVE, "red_cube", "blue_pad")


def view(shade: int = 0) -> View:
    return View(
        np.full((4, 6, 3), shade, np.uint8),
        np.zeros((4, 6), np.float32),
        np.ones((4, 6), np.bool_),
        np.zeros((2, 6)),
        np.zeros(2),
    )


def given(instruction: str = "go", *past: PastStep) -> PolicyInput:
    return PolicyInput(instruction, ("red robot", "white robot"), view(9), past)


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


def test_the_parts_keep_their_interfaces() -> None:
    policy = PlannerWithGrounder(StopsAt(), Remembers())
    assert isinstance(policy, Policy)
    assert isinstance(MultiStep(StopsAt()), Planner)
    assert isinstance(Remembers(), Grounder)
    assert not isinstance(Remembers(), Planner)


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
