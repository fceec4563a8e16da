"""The numbers of states and actions in data sets: measured, and commanded."""

import numpy as np
import pytest

import lemma
from lemma.core.poses import FloatArray
from lemma.env.control.modes import CONTROLS
from lemma.env.control_env import ControlEnv
from lemma.env.learning.motor_state import (
    MOTOR_CONTROLS,
    MOTORS,
    WAYPOINT,
    motor_names,
    motor_state,
)


def begun(control: str) -> tuple[ControlEnv, dict[str, FloatArray]]:
    env = lemma.make("hook", control=control, split="val", index=1)
    assert isinstance(env, ControlEnv)
    observation, _ = env.reset()
    return env, observation


@pytest.mark.parametrize("control", MOTOR_CONTROLS)
def test_they_are_those_of_the_control_mode(control: str) -> None:
    columns = (*CONTROLS[control].columns[:-1], "gripper")
    assert MOTORS[control] == columns
    env, observation = begun(control)
    state = motor_state(control, observation)
    assert state.shape == env.action_layout.shape
    names = motor_names(control, env.robot_names)
    assert len(set(names)) == len(names) == state.size
    assert names[0].startswith("robot_0.")
    assert names[-1] == "robot_1.gripper"


@pytest.mark.parametrize("control", MOTOR_CONTROLS)
def test_what_is_measured_commands_to_stay(control: str) -> None:
    env, first = begun(control)
    action = motor_state(control, first)
    for _ in range(20):
        observation, *_ = env.step(action)
    moved = motor_state(control, observation) - action
    assert np.abs(moved).max() < 2e-3


def test_a_pose_is_seen_from_the_base_of_its_robot() -> None:
    _, observation = begun(WAYPOINT)
    for row in motor_state(WAYPOINT, observation):
        # Where an arm waits does not depend on where its base stands.
        bearing = np.arctan2(row[1], row[0])
        assert bearing == pytest.approx(np.radians(115.0), abs=1e-3)
