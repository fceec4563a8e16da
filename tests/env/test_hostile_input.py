"""Whatever comes in is used or refused by a LemmaError, and does no harm."""

import math
import time
from typing import Any

import numpy as np
import pytest

import lemma
from lemma.core.errors import (
    InvalidActionError,
    InvalidConfigError,
    UnknownNameError,
)
from lemma.env.base_env import LemmaEnv
from lemma.expert.plan_env import PlanEnv
from lemma.tasks.subtask import STOP

LEVELS = ("control", "skill", "plan")


def make(task: str = "stack", **options: Any) -> LemmaEnv:
    return lemma.make(task, **{"split": "test", "index": 0, **options})


def assert_usable(env: LemmaEnv) -> None:
    """Whatever happened before, an episode can be begun and played."""
    env.action_space.seed(0)
    observation, info = env.reset(seed=0, options={"split": "test", "index": 0})
    assert observation in env.observation_space
    assert info["instance"] == "v2/stack/test/0"
    assert env.step(env.action_space.sample())[4]["elapsed_s"] > 0.0


@pytest.mark.parametrize(
    "options",
    [
        {"horizon_s": math.inf},
        {"horizon_s": math.nan},
        {"horizon_s": "x"},
        {"horizon_s": 0.0},
        {"control_hz": math.nan},
        {"control_hz": math.inf},
        {"control_hz": "20"},
        {"control_hz": 1e-6},
        {"width": -1},
        {"width": 1e9},
        {"width": 10**9},
        {"height": 2.5},
        {"height": "48"},
        {"index": -1},
        {"index": 10**12},
        {"index": "a"},
        {"index": math.nan},
        {"index": True},
        {"split": "free", "index": -1},
        {"split": ["test"]},
        {"split": np.array(["test", "val"])},
        {"robots": 5},
        {"robots": "ur5"},
        {"robots": ["ur5", 5]},
        {"robots": [["ur5"], "ur5"]},
        {"robots": ("ur5", "ur5", "ur5")},
        {"robots": ()},
        {"observation": None},
        {"observation": ["map"]},
        {"control": {}},
        {"instruction": np.array(["human", "unseen"])},
        {"render_mode": ["rgb_array"]},
        {"level": ["plan"]},
        {"task": None},
        {"task": ["stack"]},
        {"task": "x" * 100_000},
    ],
    ids=lambda options: repr(options)[:40],
)
def test_option_of_any_type_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises((InvalidConfigError, UnknownNameError)) as caught:
        make(**options)
    assert len(str(caught.value)) < 500


def test_options_of_numpy_types_are_fine() -> None:
    env = make(index=np.int64(3), width=np.int32(64), horizon_s=np.float32(5))
    assert env.reset()[1]["instance"] == "v2/stack/test/3"
    assert type(env.config.width) is int


@pytest.mark.parametrize("seed", ["a", 1.5, -1, True, [1], math.nan])
def test_seed_of_any_type_is_refused(seed: Any) -> None:
    env = make()
    with pytest.raises(InvalidConfigError, match="seed="):
        env.reset(seed=seed)
    assert_usable(env)
    fine: Any = np.int64(1)
    assert env.reset(seed=fine)[1]["instance"]


@pytest.mark.parametrize(
    "options",
    [
        5,
        "split",
        [("split", "test")],
        {"split": 7},
        {"split": ["test"]},
        {"index": "a"},
        {"index": 10**12},
        {"index": math.nan},
        {"index": np.array([1, 2])},
        {"instance": 5},
        {"instance": {}},
        {"instance": "v2/stack/test/0"},
        {"Split": "test"},
        {"instances": 3},
    ],
    ids=repr,
)
def test_reset_option_of_any_type_is_refused(options: Any) -> None:
    env = make()
    env.reset()
    before = env.state_hash()
    with pytest.raises((InvalidConfigError, UnknownNameError)):
        env.reset(options=options)
    assert env.state_hash() == before
    assert_usable(env)


def test_option_of_a_wrapper_is_ignored_with_one_warning() -> None:
    env = make()
    foreign = {"lerobot_new_rollout": True, "index": 2}
    with pytest.warns(UserWarning, match="'lerobot_new_rollout'.*ignored"):
        assert env.reset(options=foreign)[1]["instance"] == "v2/stack/test/2"
    # Warnings are errors in tests: a second one would raise.
    assert env.reset(options=foreign)[1]["instance"] == "v2/stack/test/2"


def test_name_of_a_foreign_option_may_be_anything() -> None:
    env = make()
    names: list[Any] = [("a", 1), 7, "100 % of %s"]
    for name in names:
        with pytest.warns(UserWarning, match="ignored"):
            env.reset(options={name: None})


def bad_arrays(good: np.ndarray) -> list[Any]:
    masked = np.ma.masked_array(good, mask=np.zeros_like(good, bool))
    masked[0, 0] = np.ma.masked
    undefined = good.copy()
    undefined[-1, -1] = math.nan
    deep: list[Any] = []
    for _ in range(5000):
        deep = [deep]
    return [
        good.astype(complex),
        good.astype(object),
        good.astype(str),
        good.astype("datetime64[s]"),
        np.zeros(good.shape, bool),
        masked,
        list(masked),
        undefined,
        np.full(good.shape, math.inf),
        good[:1],
        good[None],
        np.zeros(0),
        [[10**400] * good.shape[1]] * good.shape[0],
        None,
        {},
        {"a": good},
        "abc",
        deep,
        object(),
    ]


@pytest.mark.parametrize("control", ["ee_pose", "joint_position", "joint_torque"])
def test_array_of_any_type_is_refused_at_control_level(control: str) -> None:
    env = make(control=control)
    env.action_space.seed(0)
    env.reset()
    before = env.state_hash()
    for action in bad_arrays(env.action_space.sample()):
        with pytest.raises(InvalidActionError):
            env.step(action)
        assert env.state_hash() == before
    assert_usable(env)


@pytest.mark.parametrize("level", ["skill", "plan"])
def test_action_of_any_type_is_refused_at_sub_task_levels(level: str) -> None:
    env = make(level=level)
    env.action_space.seed(0)
    env.reset()
    good = env.action_space.sample()
    bad: list[Any] = [None, 5, "stop", [], {}, {1: 2, "a": 3}, list(good.items())]
    bad += [{**good, "extra": 1}, {1: 0, **good}]
    values: list[Any] = [None, "0", 0.0, 1j, True, math.nan, [0, 1], -1, 10**400, {}]
    values += [np.ma.masked, np.ma.masked_array(0, mask=True), np.array("0")]
    for key in good:
        if key == "poses":
            bad += [{**good, key: array} for array in bad_arrays(good[key])]
        else:
            bad += [{**good, key: value} for value in values]
    before = env.state_hash()
    for action in bad:
        with pytest.raises(InvalidActionError):
            env.step(action)
        assert env.state_hash() == before
    assert_usable(env)


@pytest.mark.parametrize(
    "actions", [None, 5, "robot_0", [], {}, {"robot_0": None}, {0: 1, "robot_1": 2}]
)
def test_agents_without_actions_are_named(actions: Any) -> None:
    env = lemma.parallel_env("stack", split="test", index=0)
    env.reset()
    before = env.state_hash()
    with pytest.raises(InvalidActionError, match="robot_0, robot_1"):
        env.step(actions)
    masked = np.ma.masked_array(np.zeros(8), mask=True)
    with pytest.raises(InvalidActionError, match="masked"):
        env.step(dict.fromkeys(env.agents, masked))
    assert env.state_hash() == before
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})


@pytest.mark.parametrize("level", LEVELS)
def test_snapshot_of_any_type_is_refused(level: str) -> None:
    env = make(level=level)
    env.reset()
    before = env.state_hash()
    junk: list[Any] = [None, "x", {}, env.episode.snapshot()]
    for snapshot in junk:
        with pytest.raises(InvalidConfigError, match="no snapshot"):
            env.restore(snapshot)
    assert env.state_hash() == before
    assert_usable(env)


@pytest.mark.parametrize("level", ["skill", "plan"])
def test_nothing_is_encoded_as_stop(level: str) -> None:
    env: Any = make(level=level)
    env.reset()
    junk: list[Any] = ["stop", 5, {}, ("robot_0",)]
    for subtask in junk:
        with pytest.raises(InvalidActionError, match="cannot be encoded"):
            env.encode(subtask)
    if isinstance(env, PlanEnv):
        assert env.decode(env.encode(None)) == STOP
    assert env.step(env.encode(None))[4]["outcome"] == "stopped"


@pytest.mark.parametrize(
    ("control_hz", "frames"), [(20.0, 20), (100.0 / 3.0, 33), (12.5, 12), (0.1, 1)]
)
def test_videos_have_whole_frame_rates(control_hz: float, frames: int) -> None:
    rate = make(control_hz=control_hz).metadata["render_fps"]
    assert (rate, type(rate)) == (frames, int)
    for level in ("skill", "plan"):
        assert type(make(level=level).metadata["render_fps"]) is int


def test_shortest_horizon_still_has_a_step() -> None:
    for level in LEVELS:
        env = make(level=level, horizon_s=0.01)
        env.reset()
        assert env.get_wrapper_attr("_max_episode_steps") == 1
        assert env.step(env.action_space.sample())[3] or level != "control"


def test_longest_horizon_costs_nothing() -> None:
    start = time.perf_counter()
    env = make(horizon_s=1e300)
    env.reset()
    env.step(env.action_space.sample())
    assert time.perf_counter() - start < 60.0
