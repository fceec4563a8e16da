"""One known question shows what a served policy understands, and what it mistakes."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest
from faulty_policies import Scripted

from lemma.cli.serve import serve as verb
from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.evaluation.run.server_check import (
    SCENE,
    check_server,
    first_subtask,
)
from lemma.expert.expert import Expert
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.serve.server import PolicyServer
from lemma.tasks.subtask import STOP, GroundedSubTask, SubTask
from lemma.tasks.suite import load_instance

pytestmark = pytest.mark.render

PARTNER = {"robot_0": "robot_1", "robot_1": "robot_0"}
Change = Callable[[GroundedSubTask], GroundedSubTask]


def right_answer() -> Decision:
    instance = load_instance(*SCENE)
    plan = Expert(Episode(instance).simulation.scene, instance.goal).plan()
    assert plan is not None
    return Decision(plan.steps[0].subtask, plan.steps[0].grounded)


class Answers:
    """Knows the answer, and says it in its own way."""

    def __init__(self, change: Change = lambda grounded: grounded) -> None:
        right = right_answer()
        assert right.grounded is not None
        grounded = change(right.grounded)
        subtask = replace(right.subtask, robot=grounded.robot)
        self.decision = Decision(subtask, grounded)
        self.given: list[PolicyInput] = []

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        self.given += inputs
        return [self.decision for _ in inputs]


class Plans:
    def __init__(self, subtask: SubTask) -> None:
        self.subtask = subtask

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        return [self.subtask for _ in inputs]


class Grounds:
    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        assert subtasks == [first_subtask()]
        return [right_answer().grounded]


def at(change: Callable[[Pose2], Pose2]) -> Change:
    return lambda grounded: replace(grounded, pick=change(grounded.pick))


def other(grounded: GroundedSubTask) -> GroundedSubTask:
    return replace(grounded, robot=PARTNER[grounded.robot])


MISTAKES: dict[str, tuple[Change, list[str]]] = {
    "none": (lambda grounded: grounded, []),
    "half a turn": (at(lambda p: Pose2(p.x, p.y, p.yaw + math.pi)), []),
    "millimetres": (at(lambda p: Pose2(1e3 * p.x, 1e3 * p.y, p.yaw)), ["pick"]),
    "axes swapped": (at(lambda p: Pose2(p.y, p.x, p.yaw)), ["pick"]),
    "y mirrored": (at(lambda p: Pose2(p.x, -p.y, p.yaw)), ["pick"]),
    "x mirrored": (at(lambda p: Pose2(-p.x, p.y, p.yaw)), ["pick"]),
    "yaw mirrored": (at(lambda p: Pose2(p.x, p.y, -p.yaw)), ["heading"]),
    "degrees": (at(lambda p: Pose2(p.x, p.y, math.degrees(p.yaw))), ["heading"]),
    "robots swapped": (other, ["robot"]),
}


@pytest.mark.parametrize(("change", "mistakes"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_of_convention_show(change: Change, mistakes: list[str]) -> None:
    policy = Answers(change)
    with PolicyServer(policy, port=0) as server:
        found = check_server(server.url)
    assert list(found.mistakes) == mistakes
    assert found.ok is (not mistakes)
    [given] = policy.given
    assert type(given) is PolicyInput
    assert given.view.rgb.max() > 0


def test_parts_are_asked_for_what_they_can_do() -> None:
    first = first_subtask()
    for part, mistakes in (
        (Plans(first), []),
        (Plans(replace(first, robot=PARTNER[first.robot])), ["robot"]),
        (Plans(STOP), ["pick"]),
        (Grounds(), []),
    ):
        with PolicyServer(part, port=0) as server:
            assert list(check_server(server.url).mistakes) == mistakes


def test_the_verb_shows_question_and_answer(capsys: pytest.CaptureFixture[str]) -> None:
    with PolicyServer(Answers(), port=0) as server:
        assert verb(check=server.url) == 0
        shown = capsys.readouterr().out
        assert load_instance(*SCENE).instructions["high_level"] in shown
        assert str(first_subtask()) in shown
        assert verb(check=server.url, as_json=True) == 0
        told: dict[str, Any] = json.loads(capsys.readouterr().out)
        assert (told["ok"], told["mistakes"]) == (True, {})
        assert told["subtask"] == first_subtask().to_dict()
    with PolicyServer(Scripted(), port=0) as server:
        assert verb(check=server.url) == 1
        assert "WRONG" in capsys.readouterr().out
