"""Observations agree with the scene."""

from typing import Any

import numpy as np
import pytest

import lemma
from lemma.core.poses import matrix_from_quaternion
from lemma.env.observation import (
    LOADS,
    OBSERVATIONS,
    TRUTH,
    read_text,
    truth_names,
    truth_vector,
    write_text,
)
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.language.blind import instruction
from lemma.tasks.language.template import EVALUATION_KINDS


def observe(observation: str, **options: Any) -> tuple[dict[str, Any], Any]:
    env = lemma.make("hook", split="test", index=5, observation=observation, **options)
    found, _ = env.reset()
    assert found in env.observation_space
    return found, env


def test_joints_are_those_of_the_physics() -> None:
    found, env = observe("state", control="joint_velocity")
    scene = env.episode.simulation.scene
    rates = np.array([[0.3, 0.1, -0.2, 0.2, 0.4, -0.5, 0.0]] * 2)
    for _ in range(8):
        found, *_ = env.step(rates)
    for i, robot in enumerate(scene.robots):
        joints = found["agent_pos"][7 * i : 7 * i + 7]
        assert np.allclose(joints[:6], scene.data.qpos[robot.qpos], atol=1e-6)
        assert joints[6] == pytest.approx(scene.opening_m(robot), abs=1e-6)
        speeds = found["agent_vel"][7 * i : 7 * i + 7]
        assert np.allclose(speeds[:6], scene.data.qvel[robot.dof], atol=1e-6)
        # The gripper closes.
        assert speeds[6] < -0.05


def test_tool_pose_is_that_of_the_site() -> None:
    found, env = observe("state")
    scene = env.episode.simulation.scene
    scene.refresh()
    for i, robot in enumerate(scene.robots):
        site = scene.data.site(f"{robot.name}/tcp")
        pose = found["tcp_pose"][7 * i : 7 * i + 7]
        assert np.allclose(pose[:3], site.xpos, atol=1e-6)
        rotation = matrix_from_quaternion(pose[3:].astype(float))
        assert np.allclose(rotation, site.xmat.reshape(3, 3), atol=1e-5)
        assert pose[3] >= 0.0


@pytest.mark.parametrize("kind", EVALUATION_KINDS)
def test_instruction_can_be_read(kind: str) -> None:
    found, env = observe("state", instruction=kind)
    assert read_text(found["instruction"]) == instruction(env.instance, kind)


def test_text_survives() -> None:
    for text in ("", "a", "Put the red cube, please!", "x" * 200):
        assert read_text(write_text(text)) == text


def test_truth_is_complete() -> None:
    found, env = observe("privileged")
    instance = env.instance
    names = {ENTITIES[i] for i in np.flatnonzero(found["present"])}
    assert names == set(instance.scene.object_names)
    for name, pose in env.info()["state"].items():
        assert np.allclose(found["objects"][ENTITIES.index(name)], pose, atol=1e-6)
    absent = found["objects"][found["present"] == 0]
    assert not absent.any()
    pairs = {(ENTITIES[a], ENTITIES[b]) for a, b in np.argwhere(found["goal"])}
    assert pairs == set(instance.goal.pairs)
    # Pairs are in the order of the goal; zeros follow the last.
    asked = [
        [found["objects"][ENTITIES.index(name)] for name in pair]
        for pair in instance.goal.pairs
    ]
    assert np.array_equal(found["goal_poses"][: len(pairs)], asked)
    assert not found["goal_poses"][len(pairs) :].any()
    assert found["robots"].shape == (2, 4)
    assert found["robots"][0, 0] < 0.0 < found["robots"][1, 0]


@pytest.mark.parametrize(("task", "hand"), [("lift", 1), ("reach", 0)])
def test_a_goals_hand_is_told_by_zeros(task: str, hand: int) -> None:
    env = lemma.make(
        task, level="skill", split="test", index=2, observation="privileged"
    )
    found, _ = env.reset()
    [cube] = lemma.load_instance(task, "test", 2).goal.entities
    number = ENTITIES.index(cube)
    assert np.argwhere(found["goal"]).tolist() == [[number, number]]
    pair = found["goal_poses"][0]
    assert not pair[hand].any()
    assert np.array_equal(pair[1 - hand], found["objects"][number])


def test_images_are_only_where_asked_for() -> None:
    keys = {
        name: set(observe(name)[0])
        for name, contents in ((n, OBSERVATIONS[n]) for n in OBSERVATIONS)
        if not contents.renders
    }
    joints = {"agent_pos", "agent_vel", "tcp_pose", "base_pose", "instruction"}
    assert keys == {
        "state": joints,
        "privileged": joints | {*TRUTH, *LOADS},
        "goal_state": joints | {"goal_state"},
    }


def test_every_number_of_the_truth_has_a_name_of_its_own() -> None:
    found, env = observe("privileged")
    names = truth_names(env.robot_names)
    told = dict(zip(names, truth_vector(found), strict=True))
    assert len(told) == len(names)
    for name, pose in env.info()["state"].items():
        assert told[f"{name}.present"] == 1.0
        assert told[f"{name}.z"] == np.float32(pose[2])
    for top, bottom in env.instance.goal.pairs:
        assert told[f"{top}.on.{bottom}"] == 1.0
    top, bottom = env.instance.goal.pairs[0]
    assert told["goal_0.bottom.y"] == told[f"{bottom}.y"]
    assert told["robot_1.base_x"] == found["robots"][1, 0]


@pytest.mark.render
def test_observing_leaves_the_physics_alone() -> None:
    hashes = set()
    for observation in ("state", "rgbd"):
        env = lemma.make(
            "hook",
            split="test",
            index=5,
            observation=observation,
            width=64,
            height=48,
            render_mode="rgb_array",
        )
        env.reset()
        env.action_space.seed(0)
        for _ in range(6):
            env.step(env.action_space.sample())
            if observation == "rgbd":
                env.render()
        hashes.add(env.state_hash())
    assert len(hashes) == 1


def test_render_without_a_mode_warns() -> None:
    env = lemma.make("stack", split="test", index=0)
    env.reset()
    with pytest.warns(UserWarning, match='render_mode="rgb_array"'):
        assert env.render() is None
