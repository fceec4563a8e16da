"""The Gymnasium face: contracts of every task and level, bad input, determinism."""

import pickle
import random
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv
from tiers import MODES, slow_but

import lemma
from lemma.core.errors import (
    InvalidActionError,
    ResetNeededError,
)
from lemma.core.poses import Pose2
from lemma.env.action_spaces import PICKS, PLACES
from lemma.env.base_env import LemmaEnv
from lemma.env.control.modes import CONTROLS
from lemma.env.skill_env import SkillEnv
from lemma.expert.plan_env import PlanEnv
from lemma.tasks.names import SUITE, gym_id
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

LEVELS = ("control", "skill", "plan")


def make(task: str = "stack", **options: Any) -> LemmaEnv:
    return lemma.make(task, **{"split": "test", **options})


def skill_env(task: str = "stack", **options: Any) -> SkillEnv:
    env = make(task, level="skill", **options)
    assert isinstance(env, SkillEnv)
    return env


def plan_env(task: str = "stack", **options: Any) -> PlanEnv:
    env = make(task, level="plan", **options)
    assert isinstance(env, PlanEnv)
    return env


def play(env: LemmaEnv, steps: int, seed: int = 0) -> list[str]:
    env.action_space.seed(seed)
    hashes = []
    for _ in range(steps):
        env.step(env.action_space.sample())
        hashes.append(env.state_hash())
    return hashes


EVERY = [(task, level) for task in SUITE for level in LEVELS]
QUICK = [("stack2", "control"), ("hook", "skill"), ("poke", "plan")]


@pytest.mark.parametrize(("task", "level"), slow_but(EVERY, *QUICK))
def test_gymnasium_finds_no_fault(task: str, level: str) -> None:
    env = gymnasium.make(gym_id(task), level=level, split="test")
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("observation", slow_but(["state", "privileged"], "state"))
@pytest.mark.parametrize("control", slow_but(CONTROLS, *MODES))
def test_gymnasium_finds_no_fault_in_any_mode(control: str, observation: str) -> None:
    reward = "dense" if "delta" in control else "sparse"
    env = make("hook_stack", control=control, observation=observation, reward=reward)
    check_env(env, skip_render_check=True)


@pytest.mark.render
def test_gymnasium_finds_no_fault_in_rendering() -> None:
    env = gymnasium.make("lemma/Hook-v0", split="test", render_mode="rgb_array")
    # The check makes an environment of every mode, and a window needs a display.
    env.unwrapped.metadata = {**env.metadata, "render_modes": ["rgb_array"]}
    check_env(env.unwrapped)
    env.reset(seed=0)
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (540, 960, 3)
    assert picture.std() > 10.0


@pytest.mark.parametrize("level", LEVELS)
def test_every_step_says_what_conventions_ask_for(level: str) -> None:
    env = gymnasium.make("lemma/Stack-v0", level=level, split="test")
    _, info = env.reset(seed=0)
    _, reward, _, truncated, later = env.step(env.action_space.sample())
    assert (reward, truncated) == (0.0, False)
    for found in (info, later):
        assert found["is_success"] is found["success"] is False
        assert found["instruction"] == env.get_wrapper_attr("task_description")
        assert set(found["idle_s"]) == {"robot_0", "robot_1"}
        assert {"progress", "elapsed_s", "failure", "instance", "state"} <= set(found)
        assert ("outcome" in found) == (level != "control")
    assert env.get_wrapper_attr("task") == "stack"
    assert env.get_wrapper_attr("_max_episode_steps") > 0
    assert env.metadata["render_modes"] == ["rgb_array", "human"]


def test_instance_depends_on_split_and_index_alone() -> None:
    env = make(split="train")
    env.reset(seed=1)
    fresh = make().reset(options={"split": "val", "index": 7})[1]
    play(env, 3)
    again = env.reset(options={"split": "val", "index": 7})[1]
    assert again["instance"] == fresh["instance"] == "v3/stack/val/7"
    assert str(again["state"]) == str(fresh["state"])


def test_seed_draws_the_same_instances() -> None:
    env = make(split="train")
    first = [env.reset(seed=5)[1]["instance"], *(env.reset()[1]["instance"],)]
    env.reset()
    assert [env.reset(seed=5)[1]["instance"], env.reset()[1]["instance"]] == first
    assert first[0] != first[1]


@pytest.mark.parametrize("control", slow_but(CONTROLS, *MODES))
def test_same_actions_lead_to_the_same_state(control: str) -> None:
    env = make(control=control)
    env.reset(options={"index": 2})
    first = play(env, 15)
    env.reset(options={"index": 3})
    play(env, 4, seed=9)
    env.reset(options={"index": 2})
    assert play(env, 15) == first


@pytest.mark.parametrize("control", slow_but(CONTROLS, *MODES))
def test_snapshot_continues_to_the_bit(control: str) -> None:
    env = make("hook", control=control)
    env.reset(options={"index": 4})
    play(env, 10)
    snapshot = pickle.loads(pickle.dumps(env.snapshot()))
    future = play(env, 15, seed=1)
    env.restore(snapshot)
    assert play(env, 15, seed=1) == future
    other = make("hook", control=control)
    other.restore(snapshot)
    assert play(other, 15, seed=1) == future


def test_snapshot_between_sub_tasks_continues_to_the_bit() -> None:
    env = plan_env("hook")
    expert = lemma.ExpertPolicy(env)
    env.reset(options={"index": 1})
    env.step(expert.act())
    snapshot, action = env.snapshot(), expert.act()
    future = env.step(action)
    after = env.state_hash()
    observation, info = env.restore(snapshot)
    assert info["outcome"] == "success"
    again = env.step(action)
    assert env.state_hash() == after
    assert str(again) == str(future)
    assert observation in env.observation_space


def test_vector_of_four_is_four_singles() -> None:
    envs = gymnasium.make_vec(
        "lemma/Stack-v0", num_envs=4, vectorization_mode="sync", split="test"
    )
    assert isinstance(envs, SyncVectorEnv)
    observations, _ = envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(10)]
    for action in actions:
        envs.step(action)
    hashes = envs.call("state_hash")
    for i in range(4):
        single = make()
        first, _ = single.reset(seed=i)
        for action in actions:
            single.step(action[i])
        assert single.state_hash() == hashes[i]
        assert (observations["agent_pos"][i] == first["agent_pos"]).all()
    envs.close()


@pytest.mark.slow
@pytest.mark.render
def test_vector_of_processes_renders() -> None:
    envs = gymnasium.make_vec(
        "lemma/Poke-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        split="test",
        observation="rgb",
        width=64,
        height=48,
    )
    observations, infos = envs.reset(seed=0)
    single = make("poke", observation="rgb", width=64, height=48)
    for i in range(2):
        first, info = single.reset(seed=i)
        assert (
            observations["pixels"]["robot_0_wrist"][i]
            == first["pixels"]["robot_0_wrist"]
        ).all()
        assert (observations["instruction"][i] == first["instruction"]).all()
        assert infos["instruction"][i] == info["instruction"]
    assert observations["pixels"]["table"].shape == (2, 48, 64, 3)
    envs.close()


@pytest.mark.parametrize(("task", "level"), [("pass", "skill"), ("stack", "plan")])
def test_expert_solves_it_in_a_three_line_loop(task: str, level: str) -> None:
    env = gymnasium.make(gym_id(task), level=level, split="test", index=0)
    expert = lemma.ExpertPolicy(env)
    observation, _ = env.reset()
    rewards, done = [], False
    while not done:
        action = expert.act(observation)
        assert action in env.action_space
        observation, reward, done, _, info = env.step(action)
        rewards.append(reward)
    assert rewards == [0.0] * (len(rewards) - 1) + [1.0]
    assert info["is_success"]
    assert info["outcome"] == "stopped"
    with pytest.raises(ResetNeededError, match="reset"):
        env.step(action)


def test_plan_level_is_what_the_expert_does_alone() -> None:
    env = plan_env("poke", index=2)
    expert = lemma.ExpertPolicy(env)
    env.reset()
    while not env.step(expert.act())[2]:
        pass
    episode = lemma.Episode(env.instance)
    lone = lemma.Expert(episode.simulation.scene, episode.instance.goal)
    assert len(list(lemma.solve(episode, lone))) > 0
    assert env.state_hash() == episode.simulation.scene.state_hash()


def test_time_ends_an_episode_of_refusals() -> None:
    env = plan_env(horizon_s=5.0)
    env.reset(seed=0)
    refused = env.encode(SubTask("robot_0", Primitive.MOVE, "stick", "shared"))
    steps = [env.step(refused) for _ in range(5)]
    assert [step[3] for step in steps] == [False] * 4 + [True]
    assert not any(step[2] for step in steps)
    assert {step[4]["outcome"] for step in steps} == {"invalid"}
    assert "no stick on this table" in steps[0][4]["explanation"]
    assert env.info()["failure"] == "out_of_time"


def test_control_level_is_truncated_in_time() -> None:
    env = make(horizon_s=1.0, control="joint_velocity")
    env.reset(seed=0)
    assert env.get_wrapper_attr("_max_episode_steps") == 20
    rest = np.zeros((2, 7), np.float32)
    steps = [env.step(rest) for _ in range(20)]
    assert [step[3] for step in steps] == [False] * 19 + [True]
    with pytest.raises(ResetNeededError):
        env.step(rest)


@pytest.mark.parametrize("split", ["train", "free"])
def test_team_can_be_chosen(split: str) -> None:
    env = make(split=split, robots=("ur10", "ur5"))
    teams = set()
    for seed in range(6):
        env.reset(seed=seed)
        teams.add(tuple(robot.arm for robot in env.instance.scene.robots))
    assert teams <= {("ur5", "ur10"), ("ur10", "ur5")}
    if split == "free":
        assert teams == {("ur10", "ur5")}


def test_sub_tasks_survive_encoding() -> None:
    rng = random.Random(0)
    plan, skill = plan_env(), skill_env()
    for _ in range(50):
        primitive = rng.choice([p for p in Primitive if p is not Primitive.STOP])
        robot = rng.choice(["robot_0", "robot_1"])
        subtask = SubTask(robot, primitive, rng.choice(PICKS), rng.choice(PLACES))
        assert plan.decode(plan.encode(subtask)) == subtask
        pick, place = (
            Pose2(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-3, 3))
            for _ in range(2)
        )
        grounded = GroundedSubTask(robot, primitive, pick, place)
        assert skill.decode(skill.encode(grounded)) == grounded
    assert plan.decode(plan.encode(STOP)) == STOP
    assert skill.decode(skill.encode(None)) is None
    with pytest.raises(InvalidActionError, match="red_cube"):
        plan.encode(SubTask("robot_0", Primitive.MOVE, "purple_cube", "shared"))
