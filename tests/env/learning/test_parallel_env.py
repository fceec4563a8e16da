"""The PettingZoo face: one agent per robot."""

from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidActionError, ResetNeededError
from lemma.env.learning.parallel_env import LemmaParallelEnv
from lemma.tasks.names import SUITE


def parallel(task: str = "stack", **options: Any) -> LemmaParallelEnv:
    return lemma.parallel_env(task, **{"split": "test", "index": 0, **options})


def sample(env: LemmaParallelEnv) -> dict[str, Any]:
    return {agent: env.action_space(agent).sample() for agent in env.agents}


@pytest.mark.filterwarnings("ignore:The option 'options' of reset")
@pytest.mark.parametrize(
    ("task", "control"),
    [
        *slow_but(
            [(task, "joint_position") for task in SUITE], ("hook", "joint_position")
        ),
        *(("stack", "joint_velocity"), ("stack", "joint_torque")),
    ],
)
def test_pettingzoo_finds_no_fault(task: str, control: str) -> None:
    env = parallel(task, control=control, horizon_s=1.0)
    parallel_api_test(env, num_cycles=30)


@pytest.mark.parametrize("level", ["parallel", "control", "skill", "plan"])
@pytest.mark.parametrize("reward", ["sparse", "dense"])
def test_numeric_info_is_numbers_of_constant_shape(level: str, reward: str) -> None:
    options: dict[str, Any] = {"reward": reward, "numeric_info": True, "split": "test"}
    if level == "parallel":
        env: Any = lemma.parallel_env("stack", **options)
    else:
        env = lemma.make("stack", level=level, **options)
    seen = set()
    # Tables with other numbers of objects.
    for index in (0, 1):
        _, info = env.reset(options={"index": index})
        infos = info.values() if level == "parallel" else [info]
        for one in infos:
            shapes = {name: np.asarray(value).shape for name, value in one.items()}
            kinds = {np.asarray(value).dtype.kind for value in one.values()}
            assert kinds <= set("bif")
            seen.add(str(sorted(shapes.items())))
    assert len(seen) == 1
    assert ("potential" in seen.pop()) == (reward == "dense")


def test_agents_together_are_the_central_environment() -> None:
    agents, central = parallel(), lemma.make("stack", split="test", index=0)
    observations, _ = agents.reset(seed=0)
    whole, _ = central.reset(seed=0)
    for agent in agents.possible_agents:
        agents.action_space(agent).seed(3)
    for _ in range(8):
        actions = sample(agents)
        observations, *_ = agents.step(actions)
        whole, *_ = central.step(np.array([actions[a] for a in agents.agents]))
    assert agents.state_hash() == central.state_hash()
    for key in ("agent_pos", "agent_vel", "tcp_pose"):
        parts = [observations[agent][key] for agent in agents.agents]
        assert (np.concatenate(parts) == whole[key]).all()
    for agent, found in observations.items():
        assert agents.observation_space(agent).contains(found)


def test_reward_is_shared_and_the_end_common() -> None:
    env = parallel(horizon_s=0.5)
    env.reset()
    for _ in range(10):
        _, rewards, terminations, truncations, infos = env.step(sample(env))
    assert set(truncations.values()) == {True}
    assert set(terminations.values()) == {False}
    assert len(set(rewards.values())) == 1
    assert infos["robot_0"]["is_success"] is infos["robot_1"]["is_success"] is False
    assert env.agents == []
    with pytest.raises(ResetNeededError):
        env.step({a: env.action_space(a).sample() for a in env.possible_agents})


def test_bad_row_is_an_error_of_its_robot() -> None:
    env = parallel()
    env.reset()
    before = env.state_hash()
    actions = sample(env)
    actions["robot_1"] = np.full(8, np.nan)
    with pytest.raises(InvalidActionError, match="of robot_1 is nan"):
        env.step(actions)
    assert env.state_hash() == before
