"""Libraries of learners take the tables: skrl, rsl_rl, Gymnasium."""

import warnings
from typing import Any

import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)
torch = pytest.importorskip("torch")

import gymnasium  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402

from lemma.warp.learners import RobotsEnv, rows_of  # noqa: E402
from lemma.warp.vector_env import GpuVecEnv  # noqa: E402

SMALL = {"pool": 2, "device": "cpu", "control_hz": 20.0}


def test_robots_are_agents_with_the_reward_of_the_team() -> None:
    env = RobotsEnv(GpuVecEnv("reach_fixed", 2, control="delta_joint", **SMALL))
    shown, _ = env.reset(seed=1)
    assert env.possible_agents == ["robot_0", "robot_1"]
    for name in env.agents:
        assert shown[name].shape == (2, *env.observation_spaces[name].shape)
        assert env.action_spaces[name].shape == (7,)
    assert env.state().shape == (2, *env.state_space.shape)
    idle = {name: torch.zeros(2, 7) for name in env.agents}
    waved = idle | {"robot_1": torch.ones(2, 7)}
    after, reward, terminated, truncated, _ = env.step(waved)
    assert torch.equal(reward["robot_0"], reward["robot_1"])
    assert not any(bool(value.any()) for value in (*terminated.values(),))
    assert not bool(truncated["robot_0"].any())
    turned = {name: (after[name] - shown[name])[:, :6].abs().max() for name in shown}
    assert float(turned["robot_1"]) > 10.0 * float(turned["robot_0"])


@pytest.mark.parametrize(("task", "arms"), [("relay", 3), ("carousel", 4)])
def test_teams_of_more_arms_play(task: str, arms: int) -> None:
    env = RobotsEnv(GpuVecEnv(task, 1, control="delta_ee_pose", **SMALL))
    assert len(env.agents) == arms
    shown, _ = env.reset(seed=0)
    down = torch.zeros(1, 7)
    down[:, 2] = -0.2
    after, reward, terminated, _, _ = env.step(dict.fromkeys(env.agents, down))
    env.env.check()
    for name in env.agents:
        # In the goal state, the second number is the height of the hand.
        assert float(after[name][0, 15]) < float(shown[name][0, 15])
        assert bool(reward[name].isfinite().all())
        assert not bool(terminated[name].any())


def test_rows_are_what_each_robot_is_given() -> None:
    env = GpuVecEnv("reach_fixed", 2, **SMALL)
    observation, info = env.reset(seed=1)
    rows = rows_of(observation, 2)
    assert rows.shape == (2, 2, 7 + 7 + 13 + 4 + 4 + 3 + 1)
    assert torch.equal(rows[:, 1, :7], observation["agent_pos"][:, 7:])
    told = [env.texts[i] for i in info["sentence"].tolist()]
    assert told == env.sentences()


def test_skrl_trains_agents_with_one_critic() -> None:
    pytest.importorskip("skrl", reason="skrl is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from learn_with_skrl import ROLLOUT, train  # noqa: PLC0415

        env = train("reach_fixed", ROLLOUT + 1, 2, **SMALL)
    assert env.env._steps == ROLLOUT + 1


def test_rsl_rl_trains_all_robots_as_one_agent() -> None:
    pytest.importorskip("rsl_rl", reason="rsl_rl is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from learn_with_rsl_rl import ROLLOUT, train  # noqa: PLC0415

        env = train("reach_fixed", 1, 2, None, **SMALL)
    assert env.env._steps == ROLLOUT


def on_host(found: Any) -> Any:
    """Return an observation as arrays."""
    if isinstance(found, dict):
        return {key: on_host(value) for key, value in found.items()}
    return found.numpy()


def test_gymnasium_takes_it_for_a_vector_environment() -> None:
    inner = GpuVecEnv("lift_fixed", 2, horizon_s=0.1, observation="rgbd", width=16,
                      height=12, **SMALL)  # fmt: skip
    assert isinstance(inner, gymnasium.vector.VectorEnv)
    n = inner.num_envs
    assert inner.observation_space == batch_space(inner.single_observation_space, n)
    assert inner.action_space == batch_space(inner.single_action_space, n)
    assert inner.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    first, _ = inner.reset(seed=5)
    assert on_host(first) in inner.observation_space
    again, info = inner.reset(seed=5)
    assert info["instance"].shape == (n,)
    for key in ("agent_pos", "goal_state"):
        assert torch.equal(first[key], again[key])
    actions = torch.from_numpy(inner.action_space.sample())
    observation, reward, terminated, truncated, _ = inner.step(actions)
    assert on_host(observation) in inner.observation_space
    assert reward.shape == terminated.shape == truncated.shape == (n,)
    assert not truncated.any()
    kept = observation["agent_pos"].clone()
    _, _, _, truncated, info = inner.step(actions)
    # The horizon is two steps. Results of the step before are not written over.
    assert truncated.all()
    assert not terminated.any()
    assert torch.equal(observation["agent_pos"], kept)
    assert info["_final_obs"].all()
