"""Libraries of learners take the tables: skrl, rsl_rl, Gymnasium."""

import warnings

import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)
torch = pytest.importorskip("torch")

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
