"""Input is used, or refused with a list of valid values, and does no harm."""

import math
import time
from typing import Any

import gymnasium
import numpy as np
import pytest

import lemma
from lemma.core.errors import (
    InvalidActionError,
    InvalidConfigError,
    ResetNeededError,
    UnknownNameError,
)
from lemma.core.poses import Pose2
from lemma.env.base_env import LemmaEnv
from lemma.env.skill_env import SkillEnv
from lemma.expert.plan_env import PlanEnv
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

LEVELS = ("control", "skill", "plan")


def make(task: str = "stack", **options: Any) -> LemmaEnv:
    return lemma.make(task, **{"split": "test", "index": 0, **options})


def assert_usable(env: LemmaEnv) -> None:
    """An episode can be begun and played after any input."""
    env.action_space.seed(0)
    observation, info = env.reset(seed=0, options={"split": "test", "index": 0})
    assert observation in env.observation_space
    assert info["instance"] == "v3/stack/test/0"
    action = env.action_space.sample()
    if "primitive" in action:
        action["primitive"] = 0
    assert env.step(action)[4]["elapsed_s"] > 0.0


def assert_refused(env: LemmaEnv, actions: list[tuple[Any, str]]) -> None:
    """Every action is refused in these words, and none of them moves anything."""
    env.action_space.seed(0)
    env.reset()
    before = env.state_hash()
    for action, words in actions:
        with pytest.raises(InvalidActionError, match=words):
            env.step(action)
        assert env.state_hash() == before
    assert_usable(env)


# --- Options of make and reset, and seeds -------------------------------------------

BAD_OPTIONS: list[tuple[dict[str, Any], str]] = [
    ({"task": "juggle"}, "Valid: pass, pass2"),
    ({"task": None}, "."),
    ({"task": ["stack"]}, "."),
    ({"task": "x" * 100_000}, "."),
    ({"level": "dream"}, "control, skill, plan"),
    ({"level": ["plan"]}, "."),
    ({"control": "thought"}, "ee_pose"),
    ({"control": {}}, "."),
    ({"observation": "smell"}, "rgbd"),
    ({"observation": None}, "."),
    ({"observation": ["map"]}, "."),
    ({"split": "tset"}, "Did you mean 'test'"),
    ({"split": ["test"]}, "."),
    ({"split": np.array(["test", "val"])}, "."),
    ({"split": "free", "index": -1}, "."),
    ({"index": -1}, "from 0 to 59"),
    ({"index": 10**12}, "."),
    ({"index": "a"}, "."),
    ({"index": math.nan}, "."),
    ({"index": True}, "."),
    ({"instruction": "robot"}, "high_level"),
    ({"instruction": np.array(["human", "unseen"])}, "."),
    ({"robots": ("ur5", "ur7")}, "ur10"),
    ({"robots": ("ur5",)}, "'ur5', 'ur10'"),
    ({"robots": 5}, "tuple"),
    ({"robots": "ur5"}, "tuple"),
    ({"robots": ["ur5", 5]}, "."),
    ({"robots": [["ur5"], "ur5"]}, "."),
    ({"robots": ("ur5", "ur5", "ur5")}, "."),
    ({"robots": ()}, "."),
    ({"render_mode": "video"}, "rgb_array, human"),
    ({"render_mode": ["rgb_array"]}, "."),
    ({"control_hz": 30}, "Try 10, 20, 25 or 50"),
    ({"control_hz": 0}, "from 0.1 to 100"),
    ({"control_hz": math.nan}, "."),
    ({"control_hz": math.inf}, "."),
    ({"control_hz": "20"}, "."),
    ({"control_hz": 1e-6}, "."),
    ({"horizon_s": -1.0}, "at least 0.01"),
    ({"horizon_s": 0.0}, "."),
    ({"horizon_s": math.inf}, "."),
    ({"horizon_s": math.nan}, "."),
    ({"horizon_s": "x"}, "."),
    ({"width": 0}, "at least 1"),
    ({"width": 1e9}, "."),
    ({"width": 10**9}, "."),
    ({"height": 2.5}, "."),
    ({"height": "48"}, "."),
    ({"numeric_info": 1}, "True or False"),
    ({"colour": "red"}, "control_hz"),
]


@pytest.mark.parametrize(("options", "words"), BAD_OPTIONS, ids=lambda o: repr(o)[:40])
def test_bad_option_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises((InvalidConfigError, UnknownNameError), match=words) as caught:
        make(**options)
    assert len(str(caught.value)) < 500


def test_options_of_numpy_types_are_fine() -> None:
    env = make(index=np.int64(3), width=np.int32(64), horizon_s=np.float32(5))
    assert env.reset(seed=np.int64(1))[1]["instance"] == "v3/stack/test/3"  # type: ignore[arg-type]
    assert type(env.config.width) is int


BAD_RESETS: list[tuple[Any, str]] = [
    ({"indx": 3}, "Did you mean 'index'"),
    ({"Split": "test"}, "."),
    ({"instances": 3}, "."),
    ({"split": "lost"}, "train, val, test, free"),
    ({"split": 7}, "."),
    ({"split": ["test"]}, "."),
    ({"index": 60}, "from 0 to 59"),
    ({"index": -1}, "from 0 to 59"),
    ({"index": 1.5}, "whole"),
    ({"index": "a"}, "."),
    ({"index": 10**12}, "."),
    ({"index": math.nan}, "."),
    ({"index": np.array([1, 2])}, "."),
    ({"instance": 5}, "."),
    ({"instance": {}}, "."),
    ({"instance": "v3/stack/test/0"}, "."),
    (5, "."),
    ("split", "."),
    ([("split", "test")], "."),
]
BAD_SEEDS: list[Any] = ["a", 1.5, -1, True, [1], math.nan]


def test_bad_resets_are_refused_and_do_no_harm() -> None:
    env = make()
    env.reset()
    before = env.state_hash()
    for options, words in BAD_RESETS:
        with pytest.raises((InvalidConfigError, UnknownNameError), match=words):
            env.reset(options=options)
    for seed in BAD_SEEDS:
        with pytest.raises(InvalidConfigError, match="seed="):
            env.reset(seed=seed)
    assert env.state_hash() == before
    assert_usable(env)


def test_option_of_a_wrapper_is_ignored_with_one_warning() -> None:
    env = make()
    foreign = {"lerobot_new_rollout": True, "index": 2}
    with pytest.warns(UserWarning, match="'lerobot_new_rollout'.*ignored"):
        assert env.reset(options=foreign)[1]["instance"] == "v3/stack/test/2"
    # Warnings are errors in tests: a second one would raise.
    assert env.reset(options=foreign)[1]["instance"] == "v3/stack/test/2"
    names: list[Any] = [("a", 1), 7, "100 % of %s"]
    for name in names:
        with pytest.warns(UserWarning, match="ignored"):
            env.reset(options={name: None})


def test_given_instance_must_have_the_team() -> None:
    wanted = next(
        instance
        for instance in (lemma.load_instance("stack", "test", i) for i in range(60))
        if instance.team == "ur5+ur5"
    )
    assert make().reset(options={"instance": wanted})[1]["instance"] == wanted.key
    with pytest.raises(InvalidConfigError, match="robots=None"):
        make(index=None, robots=("ur10", "ur10")).reset(options={"instance": wanted})


# --- Actions ------------------------------------------------------------------------


def bad_arrays(good: np.ndarray) -> list[tuple[Any, str]]:
    masked = np.ma.masked_array(good, mask=np.zeros_like(good, bool))
    masked[0, 0] = np.ma.masked
    outside, undefined = good.copy(), good.copy()
    outside[1, 2], undefined[0, 0] = 9999.0, math.nan
    deep: list[Any] = []
    for _ in range(5000):
        deep = [deep]
    words = {
        "no array of numbers": ([[1, 2], [3]], "left"),
        r"of robot_1 is 9999, not in \[.*ClipAction|y of place": (outside,),
        "robot_0 is nan|x of pick is nan": (undefined,),
        ".": (
            *(good.astype(kind) for kind in (complex, object, str, "datetime64[s]")),
            *(np.zeros(good.shape, bool), masked, list(masked)),
            *(np.full(good.shape, math.inf), good[:1], good[None], np.zeros(0)),
            [[10**400] * good.shape[1]] * good.shape[0],
            *(None, {}, {"a": good}, "abc", deep, object()),
        ),
    }
    return [(action, text) for text, actions in words.items() for action in actions]


@pytest.mark.parametrize("control", ["ee_pose", "joint_position", "joint_torque"])
def test_bad_array_is_refused_at_control_level(control: str) -> None:
    env = make(control=control)
    good = env.action_space.sample()
    width = good.shape[1]
    assert_refused(
        env,
        [
            *bad_arrays(good),
            (good[0], rf"shape \({width},\)"),
            (good.reshape(-1), rf"reshape\(\(2, {width}\)\)"),
        ],
    )


@pytest.mark.parametrize("level", ["skill", "plan"])
def test_bad_action_is_refused_at_sub_task_levels(level: str) -> None:
    env = make(level=level)
    good = env.action_space.sample()
    bad: list[tuple[Any, str]] = [
        (None, "a dictionary with"),
        ({"robot": 0}, "a dictionary with"),
        ({**good, "robot": 2}, "0 robot_0, 1 robot_1"),
        ({**good, "primitive": -1}, "0 move"),
        ({**good, "primitive": 1.0}, "whole numbers"),
    ]
    others: list[Any] = [5, "stop", [], {}, {1: 2, "a": 3}, list(good.items())]
    others += [{**good, "extra": 1}, {1: 0, **good}]
    values: list[Any] = [None, "0", 0.0, 1j, True, math.nan, [0, 1], -1, 10**400, {}]
    values += [np.ma.masked, np.ma.masked_array(0, mask=True), np.array("0")]
    for key in good:
        if key != "poses":
            others += [{**good, key: value} for value in values]
    if level == "skill":
        poses = good["poses"]
        bad += [({**good, "poses": np.full((2, 3), np.inf)}, r"x of pick is inf")]
        bad += [({**good, "poses": np.zeros(3)}, r"shape \(3,\)")]
        others += [{**good, "poses": array} for array, _ in bad_arrays(poses)]
    else:
        bad += [
            ({**good, "pick": 12}, "11 stick"),
            ({**good, "place": 13}, "12 shared"),
        ]
    assert_refused(env, [*bad, *((action, ".") for action in others)])


def test_quaternion_of_length_zero_is_no_pose() -> None:
    action = np.zeros((2, 8))
    action[0, 4] = 1.0
    words = "quaternion of robot_1 has length 0"
    assert_refused(make(control="ee_pose"), [(action, words)])


def test_action_clipped_in_single_precision_is_in_bounds() -> None:
    env = make(control="joint_position")
    env.reset(seed=0)
    space = env.action_space
    assert isinstance(space, gymnasium.spaces.Box)
    env.step(np.full(space.shape, 100.0, np.float32).clip(space.low, space.high))


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


def test_step_needs_a_reset() -> None:
    env = make()
    with pytest.raises(ResetNeededError, match="reset"):
        env.step(env.action_space.sample())


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


# --- Sub-tasks that cannot be -------------------------------------------------------


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
        *_, info = env.step(
            env.encode(SubTask("robot_0", Primitive.MOVE, "", "shared"))
        )
        assert info["outcome"] == "invalid"
        assert "needs" in info["explanation"]
    assert env.step(env.encode(None))[4]["outcome"] == "stopped"


def test_skill_on_the_bare_table_and_out_of_reach_is_explained() -> None:
    env = make(level="skill")
    assert isinstance(env, SkillEnv)
    env.reset()
    cubes = [
        Pose2(*pose[:2])
        for name, pose in env.info()["state"].items()
        if name.endswith("_cube") and pose[0] > 0.3
    ]
    bare = [Pose2(0.9, 1.0), Pose2(-0.9, 1.0)]
    assert cubes
    for places, outcome in ((bare, "nothing_to_pick"), (cubes, "unreachable")):
        for place in places:
            subtask = GroundedSubTask("robot_0", Primitive.MOVE, place, Pose2(0.0, 0.0))
            assert env.step(env.encode(subtask))[4]["outcome"] == outcome


# --- Limits -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("control_hz", "frames"), [(20.0, 20), (100.0 / 3.0, 33), (12.5, 12), (0.1, 1)]
)
def test_videos_have_whole_frame_rates(control_hz: float, frames: int) -> None:
    for level in LEVELS:
        rate = make(level=level, control_hz=control_hz).metadata["render_fps"]
        assert type(rate) is int
        assert rate == frames or level != "control"


@pytest.mark.parametrize("level", LEVELS)
def test_shortest_horizon_still_has_a_step(level: str) -> None:
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
