"""What is wrong is said, with what is valid and what to try, and does no harm."""

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
from lemma.scene.objects.entity import ENTITIES
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


def sub_tasks_that_cannot_be() -> list[tuple[str, SubTask, str, str]]:
    move, hook = Primitive.MOVE, Primitive.HOOK
    return [
        ("nothing", SubTask("robot_0", move, "", "shared"), "invalid", "needs"),
        ("pad", SubTask("robot_0", move, "PAD", "shared"), "invalid", "fixed"),
        ("absent", SubTask("robot_0", move, "ABSENT", "shared"), "invalid", "no "),
        ("onto itself", SubTask("robot_0", move, "CUBE", "CUBE"), "invalid", "cannot"),
        ("by cube", SubTask("robot_0", hook, "CUBE", "CUBE"), "invalid", "stick"),
        ("too early", SubTask("robot_0", hook, "stick", "CUBE"), "invalid", "prehook"),
        ("too far", SubTask("FAR", move, "CUBE", "shared"), "unreachable", "reach"),
    ]


@pytest.mark.parametrize("case", sub_tasks_that_cannot_be(), ids=lambda case: case[0])
def test_impossible_sub_task_is_explained(case: tuple[str, SubTask, str, str]) -> None:
    _, subtask, outcome, words = case
    env = plan_env("hook", index=0)
    _, before = env.reset()
    (goal,) = env.instance.goal.pairs
    absent = next(name for name in ENTITIES if name not in before["state"])
    names = {"CUBE": goal[0], "PAD": goal[1], "ABSENT": absent, "FAR": "robot_0"}
    filled = SubTask(
        names.get(subtask.robot, subtask.robot),
        subtask.primitive,
        names.get(subtask.pick, subtask.pick),
        names.get(subtask.place, subtask.place),
    )
    _, reward, terminated, truncated, info = env.step(env.encode(filled))
    assert (info["outcome"], reward, terminated, truncated) == (
        outcome,
        0.0,
        False,
        False,
    )
    assert words in info["explanation"]
    assert all(
        np.allclose(info["state"][n], before["state"][n], atol=1e-4)
        for n in before["state"]
    )
    assert env.step(env.encode(STOP))[4]["failure"] == "goal_not_reached"


def test_skill_on_the_bare_table_and_out_of_reach_is_explained() -> None:
    env = skill_env(index=0)
    env.reset()
    outcomes = []
    for x in (0.9, -0.9):
        bare = GroundedSubTask(
            "robot_0", Primitive.MOVE, Pose2(x, 1.0), Pose2(0.0, 0.0)
        )
        outcomes.append(env.step(env.encode(bare))[4]["outcome"])
    assert outcomes == ["nothing_to_pick"] * 2
    reach = {
        name: GroundedSubTask(
            "robot_0", Primitive.MOVE, Pose2(*pose[:2]), Pose2(0.0, 0.0)
        )
        for name, pose in env.info()["state"].items()
        if name.endswith("_cube") and pose[0] > 0.3
    }
    assert reach
    for subtask in reach.values():
        assert env.step(env.encode(subtask))[4]["outcome"] == "unreachable"


def bad_actions(env: LemmaEnv) -> list[tuple[Any, str]]:
    good = env.action_space.sample()
    if isinstance(good, np.ndarray):
        outside, undefined = good.copy(), good.copy()
        outside[1, 2], undefined[0, 0] = 99.0, np.nan
        return [
            (outside, r"of robot_1 is 99, not in \[.*ClipAction"),
            (undefined, "robot_0 is nan"),
            (good[0], r"shape \(8,\)"),
            (good.reshape(-1), r"reshape\(\(2, 8\)\)"),
            ([[1, 2], [3]], "no array of numbers"),
            ("left", "no array of numbers"),
        ]
    bad: list[tuple[Any, str]] = [
        (None, "a dictionary with"),
        ({"robot": 0}, "a dictionary with"),
        ({**good, "robot": 2}, "0 robot_0, 1 robot_1"),
        ({**good, "primitive": -1}, "0 move"),
        ({**good, "primitive": 1.0}, "whole numbers"),
    ]
    if "poses" in good:
        poses = np.full((2, 3), np.inf)
        bad += [
            ({**good, "poses": poses}, r"x of pick is inf"),
            ({**good, "poses": np.zeros(3)}, r"shape \(3,\)"),
        ]
    else:
        bad += [
            ({**good, "pick": 12}, "11 stick"),
            ({**good, "place": 13}, "12 shared"),
        ]
    return bad


@pytest.mark.parametrize("level", LEVELS)
def test_bad_action_is_explained_and_does_no_harm(level: str) -> None:
    env = make(level=level)
    env.action_space.seed(0)
    env.reset(seed=0)
    before = env.state_hash()
    for action, words in bad_actions(env):
        with pytest.raises(InvalidActionError, match=words):
            env.step(action)
        assert env.state_hash() == before
    assert env.reset(seed=0)[0] in env.observation_space
    env.step(env.action_space.sample())


def test_quaternion_of_length_zero_is_no_pose() -> None:
    env = make(control="ee_pose")
    env.reset(seed=0)
    action = np.zeros((2, 8))
    action[0, 4] = 1.0
    before = env.state_hash()
    with pytest.raises(InvalidActionError, match="quaternion of robot_1 has length 0"):
        env.step(action)
    assert env.state_hash() == before


def test_action_clipped_in_single_precision_is_in_bounds() -> None:
    env = make(control="joint_position")
    env.reset(seed=0)
    space = env.action_space
    assert isinstance(space, gymnasium.spaces.Box)
    env.step(np.full(space.shape, 100.0, np.float32).clip(space.low, space.high))


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"task": "juggle"}, UnknownNameError, "Valid: pass, pass2"),
        ({"level": "dream"}, UnknownNameError, "control, skill, plan"),
        ({"control": "thought"}, UnknownNameError, "ee_pose"),
        ({"observation": "smell"}, UnknownNameError, "rgbd"),
        ({"split": "tset"}, UnknownNameError, "Did you mean 'test'"),
        ({"instruction": "robot"}, UnknownNameError, "high_level"),
        ({"robots": ("ur5", "ur7")}, UnknownNameError, "ur10"),
        ({"robots": ("ur5",)}, InvalidConfigError, "'ur5', 'ur10'"),
        ({"render_mode": "video"}, UnknownNameError, "rgb_array, human"),
        ({"control_hz": 30}, InvalidConfigError, "Try 10, 20, 25 or 50"),
        ({"control_hz": 0}, InvalidConfigError, "from 0.1 to 100"),
        ({"horizon_s": -1.0}, InvalidConfigError, "at least 0.01"),
        ({"width": 0}, InvalidConfigError, "at least 1"),
        ({"colour": "red"}, UnknownNameError, "control_hz"),
    ],
    ids=str,
)
def test_bad_option_is_explained(
    options: dict[str, Any], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        make(**options)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"indx": 3}, UnknownNameError, "Did you mean 'index'"),
        ({"split": "lost"}, UnknownNameError, "train, val, test, free"),
        ({"index": 60}, InvalidConfigError, "from 0 to 59"),
        ({"index": -1}, InvalidConfigError, "from 0 to 59"),
        ({"index": 1.5}, InvalidConfigError, "whole"),
    ],
    ids=str,
)
def test_bad_reset_is_explained(
    options: dict[str, Any], error: type[Exception], words: str
) -> None:
    env = make()
    with pytest.raises(error, match=words):
        env.reset(options=options)
    env.reset(seed=0)
    env.step(env.action_space.sample())


def test_step_needs_a_reset() -> None:
    env = make()
    with pytest.raises(ResetNeededError, match="reset"):
        env.step(env.action_space.sample())


def test_given_instance_must_have_the_team() -> None:
    wanted = next(
        instance
        for instance in (lemma.load_instance("stack", "test", i) for i in range(60))
        if instance.team == "ur5+ur5"
    )
    assert make().reset(options={"instance": wanted})[1]["instance"] == wanted.key
    with pytest.raises(InvalidConfigError, match="robots=None"):
        make(robots=("ur10", "ur10")).reset(options={"instance": wanted})
