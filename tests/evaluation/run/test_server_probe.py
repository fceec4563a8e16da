"""A policy's first decisions give its mistakes away."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from lemma.core.poses import Pose2
from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.env.view import View
from lemma.evaluation.run import server_probe as probing
from lemma.evaluation.run.server_probe import SCENES, probe
from lemma.expert.expert import Expert
from lemma.expert.symbolic_state import SymbolicState
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.oracle import OracleGrounder, OraclePlanner
from lemma.scene.raster import RASTER
from lemma.scene.scene import Scene
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import load_instance


class Shut(CameraRig):
    """Sees nothing, and needs no OpenGL for it."""

    def look(self, scene: Scene, robots: Sequence[str] | None = None) -> View:
        shape = (RASTER.rows, RASTER.columns)
        return View(
            np.zeros((*shape, 3), np.uint8),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.bool_),
            np.zeros((2, 6)),
            np.zeros(2),
        )


Change = Callable[[Decision], Decision]


class Expertly:
    """Decides as the expert does, with the gripper aligned; then makes a mistake."""

    def __init__(self, mistake: Change = lambda decision: decision) -> None:
        self.mistake = mistake

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        subtasks = OraclePlanner().plan(inputs)
        grounded = OracleGrounder().ground(inputs, subtasks)
        decisions = []
        for one, subtask, poses in zip(inputs, subtasks, grounded, strict=True):
            assert one.episode is not None
            assert poses is not None
            cube = SymbolicState.observe(one.episode.simulation.scene).poses[
                subtask.pick
            ]
            pick = replace(poses.pick, yaw=math.remainder(cube.yaw, math.pi / 2))
            decisions.append(self.mistake(Decision(subtask, replace(poses, pick=pick))))
        return decisions


def posed(change: Callable[[Pose2], Pose2]) -> Change:
    def mistake(decision: Decision) -> Decision:
        assert decision.grounded is not None
        pick = change(decision.grounded.pick)
        return replace(decision, grounded=replace(decision.grounded, pick=pick))

    return mistake


def swapped(decision: Decision) -> Decision:
    assert decision.grounded is not None
    robot = {"robot_0": "robot_1", "robot_1": "robot_0"}[decision.subtask.robot]
    return Decision(
        replace(decision.subtask, robot=robot),
        replace(decision.grounded, robot=robot),
    )


def first_only(decision: Decision) -> Decision:
    return swapped(decision) if decision.subtask.robot == "robot_1" else decision


def fails(decision: Decision) -> Decision:
    raise ArithmeticError("no idea")


def test_the_scenes_are_balanced() -> None:
    first = []
    for task, index in SCENES:
        episode = Episode(load_instance(task, "val", index))
        subtask, _ = Expert(episode.simulation.scene, episode.instance.goal).act()
        assert subtask.primitive is Primitive.MOVE
        first.append(subtask.robot)
    assert first.count("robot_0") == first.count("robot_1") == 4


def test_a_right_policy_passes() -> None:
    found = probe(Expertly(), Shut())
    assert not found.mistakes
    assert (found.scenes, found.picks, found.hits) == (8, 8, 8)
    assert "8 times a cube" in str(found)


MISTAKES: dict[str, tuple[Change, str, str]] = {
    "y": (posed(lambda p: Pose2(p.x, -p.y, p.yaw)), "axes", "y is mirrored"),
    "x": (posed(lambda p: Pose2(-p.x, p.y, p.yaw)), "axes", "x is mirrored"),
    "half a turn": (posed(lambda p: Pose2(-p.x, -p.y, p.yaw)), "axes", "reversed"),
    "swapped": (posed(lambda p: Pose2(p.y, p.x, p.yaw)), "axes", "swapped"),
    "mm": (posed(lambda p: Pose2(90 * p.x, 90 * p.y, p.yaw)), "", ""),
    "cm": (
        posed(lambda p: Pose2(100 * p.x, 100 * p.y, p.yaw)),
        "units of length",
        "centimetres",
    ),
    "yaw": (posed(lambda p: Pose2(p.x, p.y, -p.yaw)), "yaw sign", "other sign"),
    "robots": (swapped, "robot order", "other one"),
    "raises": (fails, "decision", "ArithmeticError"),
    # Wrong, but not in a way that anybody would call a convention.
    "elsewhere": (posed(lambda p: Pose2(p.x + 0.2, p.y, p.yaw)), "", ""),
    "one robot": (first_only, "", ""),
    "no yaw": (posed(lambda p: Pose2(p.x, p.y, 0.0)), "", ""),
}


@pytest.mark.parametrize("what", MISTAKES)
def test_mistakes_are_named(what: str) -> None:
    mistake, name, words = MISTAKES[what]
    found = probe(Expertly(mistake), Shut())
    assert list(found.mistakes) == ([name] if name else [])
    if name:
        assert words in found.mistakes[name]


def test_few_decisions_prove_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probing, "SCENES", SCENES[:5])
    assert not probe(Expertly(swapped), Shut()).mistakes


def test_hooks_and_stops_do_not_count() -> None:
    def hooks(decision: Decision) -> Decision:
        assert decision.grounded is not None
        pick, place = decision.grounded.pick, decision.grounded.place
        subtask = SubTask(decision.subtask.robot, Primitive.HOOK, "stick", "red_cube")
        return Decision(
            subtask, GroundedSubTask(subtask.robot, Primitive.HOOK, pick, place)
        )

    found = probe(Expertly(hooks), Shut())
    assert (found.picks, found.hits, found.mistakes) == (0, 0, {})
