"""The command of a control policy at a known moment, and the mistakes found in it."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from command import run
from model_server import HELLO, model_server

from lemma.core.robot_names import robot_number
from lemma.env.learning.motor_state import WAYPOINT, motor_state
from lemma.evaluation.run.server_check import (
    SCENE,
    ServerCheck,
    check_control,
    first_subtask,
)
from lemma.policies.control.interfaces import ControlInput
from lemma.serve.faults import PolicyFailedError
from lemma.tasks.suite import load_instance

Change = Callable[[Any], Any]

MOVES = robot_number(first_subtask().robot)
"""The robot that is on its way."""
CUBE = np.array(load_instance(*SCENE).scene.placement(first_subtask().pick).pose.xy)
"""Where it goes [m]."""


class Goes:
    """Goes on towards the cube as it should, but for one change to its numbers."""

    def __init__(self, control: str, change: Change) -> None:
        self.control_options = {"control": control, "observation": "state"}
        self.control, self.change = control, change

    def act(self, inputs: list[ControlInput]) -> list[Any]:
        return [self.change(self.rows(given.observation)) for given in inputs]

    def rows(self, seen: Any) -> Any:
        joints, poses = seen["agent_pos"].reshape(2, 7), seen["tcp_pose"].reshape(2, 7)
        opening = np.full((2, 1), 0.1)
        if self.control == "joint_position":
            return np.hstack([joints[:, :6], opening])
        if self.control == "ee_pose":
            return np.hstack([poses, opening])
        if self.control == WAYPOINT:
            # Far ahead: the end of a motion.
            rows = motor_state(WAYPOINT, seen).copy()
            rows[:, -1], rows[MOVES, :3] = 0.1, (0.3, -0.5, 0.3)
            return rows
        steps = np.zeros((2, 7))
        steps[:, -1] = 1.0
        steps[MOVES, :2] = 0.5 * (CUBE - poses[MOVES, :2])
        return steps


def swapped(rows: Any) -> Any:
    return rows[::-1]


def grippers_last(rows: Any) -> Any:
    return np.concatenate([rows[:, :-1].ravel(), rows[:, -1]]).reshape(rows.shape)


def times(factor: float, columns: slice) -> Change:
    def change(rows: Any) -> Any:
        found = rows.copy()
        found[:, columns] *= factor
        return found

    return change


def asked(control: str, change: Change = lambda x: x) -> ServerCheck:
    return check_control(Goes(control, change))


@pytest.mark.parametrize(
    "control", ["joint_position", "ee_pose", "delta_ee_pose", "ee_waypoint_rot6d"]
)
def test_nothing_is_wrong_with_what_goes_on(control: str) -> None:
    found = asked(control)
    assert found.ok, found.mistakes
    assert next(iter(found.answer["action"])).startswith("robot_0.")
    assert "red cube" in found.instruction


@pytest.mark.parametrize(
    ("control", "change", "name", "words"),
    [
        ("joint_position", swapped, "layout", "robots are in the other order"),
        ("ee_pose", swapped, "layout", "robots are in the other order"),
        ("delta_ee_pose", swapped, "direction", "robots in the other order"),
        ("joint_position", grippers_last, "layout", "both grippers last"),
        ("ee_pose", grippers_last, "layout", "both grippers last"),
        (
            "ee_pose",
            lambda rows: rows[:, [0, 1, 2, 4, 5, 6, 3, 7]],
            "layout",
            "quaternions are xyzw",
        ),
        ("joint_position", times(57.3, slice(6)), "layout", "degrees"),
        ("ee_pose", times(1000.0, slice(3)), "layout", "millimetres"),
        ("ee_pose", times(-3.0, slice(3)), "layout", "units, frame and order"),
        ("delta_ee_pose", times(-1.0, slice(-1, None)), "gripper", "-1 is closed"),
        ("joint_position", times(0.0, slice(-1, None)), "gripper", "in metres"),
        ("ee_pose", times(10.0, slice(-1, None)), "gripper", "fraction"),
        (WAYPOINT, times(0.0, slice(-1, None)), "gripper", "in metres"),
        ("delta_ee_pose", times(-1.0, slice(2)), "direction", "signs the same"),
    ],
)
def test_usual_mistakes_are_named(
    control: str, change: Change, name: str, words: str
) -> None:
    found = asked(control, change)
    assert not found.ok
    assert words in found.mistakes[name]


def test_what_is_no_action_is_an_error() -> None:
    for change, words in ((lambda rows: rows[:1], "shape"), (lambda rows: "x", "no")):
        with pytest.raises(PolicyFailedError, match=words):
            asked("joint_position", change)


def test_a_model_server_is_checked_by_the_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    hello = {**HELLO, "observation_params": {"observation": "state"}}
    closed = np.tile([1.0] * 6 + [0.0], 2)
    with model_server(
        lambda seen, step: {"actions": seen["states"] * closed}, hello=hello
    ) as url:
        assert run("serve", "--check", url) == 1
    assert "WRONG gripper" in capsys.readouterr().out
    with model_server(
        lambda seen, step: {"actions": seen["states"]}, hello=hello
    ) as url:
        assert run("serve", "--check", url, "--json") == 0
    assert json.loads(capsys.readouterr().out)["mistakes"] == {}
