"""Rewards: sparse by default; dense ones leave the best policies as they are."""

from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose
from lemma.env.base_env import LemmaEnv
from lemma.env.episode import Episode
from lemma.env.signals.rewards import REWARDS, RewardMeter, goal_potential
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.tasks.suite import SUITE

potentials = st.floats(0.0, 1.0)


def make(task: str = "stack", **options: Any) -> LemmaEnv:
    return lemma.make(
        task, **{"split": "test", "index": 0, "reward": "dense", **options}
    )


class Path:
    """An episode that goes through given potentials, as far as a reward can tell."""

    stopped = is_over = is_success = has_failed = False

    def __init__(self, potentials: list[float]) -> None:
        self._left = iter(potentials)

    def potential(self) -> float:
        return next(self._left)


@pytest.fixture(autouse=True)
def given_potential(monkeypatch: pytest.MonkeyPatch) -> None:
    potential = lambda episode: cast("Path", episode).potential()  # noqa: E731
    monkeypatch.setitem(REWARDS._records, "given", potential)


def rewards_along(path: list[float], discount: float) -> list[float]:
    meter, episode = RewardMeter("given", discount), cast("Episode", Path(path))
    meter.begin(episode)
    return [meter.reward(episode) for _ in path[1:]]


@given(st.lists(potentials, min_size=2, max_size=30), potentials)
def test_shaping_telescopes(path: list[float], discount: float) -> None:
    rewards = rewards_along(path, discount)
    total = sum(discount**k * reward for k, reward in enumerate(rewards))
    expected = discount ** len(rewards) * path[-1] - path[0]
    assert total == pytest.approx(expected, abs=1e-9)


@given(st.lists(potentials, min_size=1, max_size=30))
def test_going_in_circles_earns_nothing(path: list[float]) -> None:
    assert sum(rewards_along([*path, path[0]], 1.0)) == pytest.approx(0.0, abs=1e-9)
    # With a discount it even costs, for the time that it takes.
    assert sum(rewards_along([*path, path[0]], 0.9)) <= 1e-9


@pytest.mark.parametrize("level", ["control", "skill", "plan"])
def test_rewards_of_an_environment_telescope(level: str) -> None:
    env = make(level=level, reward_discount=0.97)
    env.action_space.seed(0)
    _, info = env.reset()
    first, total = info["potential"], 0.0
    for k in range(4):
        _, reward, terminated, _, info = env.step(env.action_space.sample())
        total += 0.97**k * (reward - float(terminated and info["is_success"]))
        if terminated:
            break
    expected = 0.97 ** (k + 1) * info["potential"] - first
    assert total == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("task", slow_but(SUITE, "stack"))
def test_potential_rises_along_the_experts_episode(task: str) -> None:
    env = make(task, level="plan")
    expert = lemma.ExpertPolicy(env)
    _, info = env.reset()
    found, done = [info["potential"]], False
    while not done:
        *_, terminated, truncated, info = env.step(expert.act())
        found.append(info["potential"])
        done = terminated or truncated
    assert info["is_success"]
    assert found[-1] == 1.0
    assert found[0] < 0.6
    # Overall: what is handed over is let go in between.
    times = np.arange(len(found))
    assert np.corrcoef(times, found)[0, 1] > 0.5
    assert all(0.0 <= value <= 1.0 for value in found)


def test_each_stage_of_a_lift_is_worth_more_than_the_one_before() -> None:
    env = lemma.make(
        "pass", split="test", index=1, reward="dense", control="delta_ee_pose"
    )
    _, info = env.reset()
    (top, _), *_ = env.instance.goal.pairs
    cube = info["state"][top][:3]
    arms = list(env.episode.simulation.arms.values())
    arm = min(arms, key=lambda a: float(np.hypot(*(a.tcp_pose()[:2, 3] - cube[:2]))))
    stages = [info["potential"]]
    action = np.zeros((2, 7))
    action[:, -1] = 1.0
    for height, grip, steps in (
        (0.15, 1, 60),
        (0.0, 1, 30),
        (0.0, -1, 15),
        (0.2, -1, 30),
    ):
        for _ in range(steps):
            offset = cube + np.array([0.0, 0.0, height]) - arm.tcp_pose()[:3, 3]
            row = action[arms.index(arm)]
            row[:3], row[-1] = np.clip(offset / 0.05, -1.0, 1.0), grip
            *_, info = env.step(action)
        stages.append(info["potential"])
    assert env.episode.simulation.held() == {arm.robot.name: top}
    assert np.all(np.diff(stages) > 0.02)


def test_success_is_worth_all_and_a_wrong_stop_nothing() -> None:
    env = make(control="joint_velocity")
    env.reset()
    scene = env.episode.simulation.scene
    ((top, bottom),) = env.instance.goal.pairs
    below = scene.pose(bottom)
    x, y, z = below.position
    scene.set_pose(top, Pose((x, y, z + CUBE_EDGE_M), below.quaternion))
    assert goal_potential(env.episode) >= 0.9
    terminated = False
    while not terminated:
        _, reward, terminated, _, info = env.step(np.zeros((2, 7)))
    assert info["is_success"]
    assert info["potential"] == 1.0
    assert reward == pytest.approx(1.0 + 0.99 - 1.0)
    stopping = make(level="skill")
    _, info = stopping.reset()
    before = info["potential"]
    _, reward, _, _, info = stopping.step(stopping.encode(None))  # type: ignore[attr-defined]
    assert (reward, info["potential"]) == (-before, 0.0)


def test_the_default_is_sparse_and_the_physics_do_not_care() -> None:
    dense, sparse = make(), make(reward="sparse")
    hashes = []
    for env in (dense, sparse):
        env.action_space.seed(1)
        _, info = env.reset()
        assert ("potential" in info) == (env is dense)
        for _ in range(5):
            _, reward, *_ = env.step(env.action_space.sample())
            assert (reward == 0.0) == (env is sparse)
        hashes.append(env.state_hash())
    assert hashes[0] == hashes[1]
    assert lemma.make("stack").config.reward == "sparse"


def test_a_restored_snapshot_is_rewarded_as_it_was() -> None:
    env = make()
    env.action_space.seed(2)
    env.reset()
    env.step(env.action_space.sample())
    snapshot, action = env.snapshot(), env.action_space.sample()
    first = env.step(action)[1]
    env.restore(snapshot)
    assert env.step(action)[1] == first


def test_unknown_rewards_and_discounts_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="dense"):
        make(reward="denes")
    with pytest.raises(InvalidConfigError, match="reward_discount"):
        make(reward_discount=1.5)
