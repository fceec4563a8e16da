"""The goal state: numbers with names, from the truth, enough to act by."""

from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import lemma
from lemma.core.poses import Pose
from lemma.env.learning.flat_view import FlatView
from lemma.env.signals.goal_state import NUMBERS, goal_state_names
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.pad import PAD_THICKNESS_M
from lemma.tasks.goal import LIFTED_M


def make(task: str, **options: Any) -> Any:
    options = {"split": "test", "index": 0, "observation": "goal_state", **options}
    return lemma.make(task, **options)


def named(env: Any, observation: dict[str, Any]) -> dict[str, float]:
    values = observation["goal_state"].tolist()
    return dict(zip(goal_state_names(env.robot_names), values, strict=True))


def world(env: Any, robot: int, state: dict[str, float], way: str) -> Any:
    """Return a way in the frame of a hand in the axes of the world."""
    arm = list(env.episode.simulation.arms.values())[robot]
    x, y = arm.tcp_pose()[:2, 3] - arm.robot.world_from_base[:2, 3]
    turn = np.arctan2(y, x)
    name = f"robot_{robot}.{way}"
    forward, left, up = (state[f"{name}_{d}"] for d in ("forward", "left", "up"))
    cos, sin = np.cos(turn), np.sin(turn)
    return [forward * cos - left * sin, forward * sin + left * cos, up]


def test_gymnasium_finds_no_fault_in_it() -> None:
    env = make("lift", control="delta_ee_pose")
    check_env(env, skip_render_check=True)
    flat = FlatView(env)
    observation, _ = flat.reset()
    assert observation in flat.observation_space
    assert observation["observation.environment_state"].shape == (26,)


@pytest.mark.parametrize("task", ["reach_fixed", "lift_varied", "place"])
def test_numbers_are_those_of_the_truth(task: str) -> None:
    env = make(task)
    observation, info = env.reset()
    state = named(env, observation)
    top, bottom = env.instance.goal.pairs[0]
    cube = info["state"][bottom if top == "hand" else top][:3]
    if bottom == "hand":
        place = np.add(cube, (0.0, 0.0, CUBE_EDGE_M / 2 + LIFTED_M - cube[2]))
    elif top == "hand":
        place = cube
    else:
        above_m = PAD_THICKNESS_M + CUBE_EDGE_M / 2
        place = np.add(info["state"][bottom][:3], (0.0, 0.0, above_m))
    for robot, arm in enumerate(env.episode.simulation.arms.values()):
        tcp = arm.tcp_pose()[:3, 3]
        assert world(env, robot, state, "object") == pytest.approx(cube - tcp, abs=1e-4)
        way = world(env, robot, state, "place")
        assert way == pytest.approx(place - cube, abs=1e-4)
        assert state[f"robot_{robot}.opening"] == pytest.approx(0.1, abs=1e-3)
        base = env.instance.scene.robots[robot].base
        reach = np.hypot(tcp[0] - base.x, tcp[1] - base.y)
        assert state[f"robot_{robot}.reach"] == pytest.approx(reach, abs=1e-5)
        assert state[f"robot_{robot}.height"] == pytest.approx(tcp[2], abs=1e-5)


def test_it_tells_of_the_first_part_of_a_goal_that_does_not_hold() -> None:
    env = make("pass2")
    env.reset()
    (top, bottom), (other, _) = env.instance.goal.pairs
    scene = env.episode.simulation.scene
    for expected in (top, other):
        state = named(env, env.observe())
        tcp = env.episode.simulation.arms["robot_1"].tcp_pose()[:3, 3]
        way = np.subtract(scene.position(expected), tcp)
        assert world(env, 1, state, "object") == pytest.approx(way, abs=1e-4)
        x, y, z = scene.position(bottom)
        # A bit lower, so that they touch.
        z += PAD_THICKNESS_M + CUBE_EDGE_M / 2 - 1e-4
        scene.set_pose(top, Pose((x, y, z), (1.0, 0.0, 0.0, 0.0)))


def test_each_agent_has_its_own_numbers() -> None:
    env = lemma.parallel_env("lift", observation="goal_state", split="test", index=0)
    both: dict[str, Any] = env.reset()[0]
    for agent in env.agents:
        assert both[agent] in env.observation_space(agent)
        assert both[agent]["goal_state"].shape == (len(NUMBERS),)


def test_a_hand_that_follows_the_numbers_lifts_the_cube() -> None:
    env = make("lift_fixed", control="delta_ee_pose", control_hz=5, clip_actions=True)
    observation, info = env.reset()
    done, held = False, list[float]()
    while not done and len(held) < 60:
        state = named(env, observation)
        x, y, z = world(env, 0, state, "object")
        beside, holds = np.hypot(x, y), state["robot_0.holds"]
        up = 0.05 if holds else z + 0.1 if beside > 0.03 else z
        there = beside < 0.01 and abs(z) < 0.008
        rows = np.zeros((2, 7))
        rows[0, :3] = np.divide([x, y, up], 0.05)
        rows[0, 5] = state["robot_0.object_turn"] / 0.25
        rows[0, 6] = -1.0 if holds or there else 1.0
        observation, _, terminated, truncated, info = env.step(rows)
        held.append(holds)
        done = terminated or truncated
    assert info["is_success"]
    assert held[0] == 0.0
    assert held[-1] == 1.0
