"""Steps of poses: what 1 means, where targets stay, and what is clipped."""

import math
from typing import Any

import numpy as np
import pytest

import lemma
from lemma.core.errors import InvalidActionError, InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.env.control.pose_controllers import HIGHEST_M, LEASH_STEPS, LOWEST_M
from lemma.env.control.rotations import (
    quaternion_from_axis_angle,
    rot6d_from_quaternion,
)
from lemma.env.control_env import ControlEnv
from lemma.motion.arm_motion import ArmMotion

DELTAS = ("delta_ee_pose", "delta_ee_pose_rot6d")
UP = (0.0, 0.0, 1.0)


def steps_env(control: str = "delta_ee_pose", **options: Any) -> ControlEnv:
    env = lemma.make("stack", control=control, split="test", index=0, **options)
    env.reset()
    return env


def arms_of(env: ControlEnv) -> list[ArmMotion]:
    return list(env.episode.simulation.arms.values())


def action_of(
    control: str, move: tuple[float, ...] = (0.0,) * 3, turn: float = 0.0
) -> FloatArray:
    """Return a step of the first arm: numbers, and a turn about the vertical [rad]."""
    turns = [(0.0, 0.0, turn), (0.0, 0.0, 0.0)]
    if control == "delta_ee_pose":
        # In units of the default step.
        written: list[Any] = [(x, y, z / 0.25) for x, y, z in turns]
    else:
        written = [rot6d_from_quaternion(quaternion_from_axis_angle(t)) for t in turns]
    rows = [[*m, *r, 1.0] for m, r in zip((move, (0.0,) * 3), written, strict=True)]
    return np.array(rows)


@pytest.mark.parametrize("control", DELTAS)
def test_a_step_moves_the_target_by_the_documented_scale(control: str) -> None:
    env = steps_env(control)
    arm, other = arms_of(env)
    start, waiting = arm.tcp_pose(), other.tcp_pose()
    env.step(action_of(control, move=(0.5, -1.0, 0.2), turn=0.2))
    goal = arm.workspace.goal
    moved = goal.position - start[:3, 3]
    np.testing.assert_allclose(moved, [0.025, -0.05, 0.01], atol=1e-9)
    turned = goal.rotation @ start[:3, :3].T
    angle = math.atan2(turned[1, 0], turned[0, 0])
    assert angle == pytest.approx(0.2)
    np.testing.assert_allclose(other.workspace.goal.position, waiting[:3, 3], atol=1e-9)


@pytest.mark.parametrize("control", DELTAS)
def test_the_hand_follows_and_stays_where_it_was_led(control: str) -> None:
    env = steps_env(control, control_hz=10)
    arm = arms_of(env)[0]
    start = arm.tcp_pose()
    for _ in range(4):
        env.step(action_of(control, move=UP, turn=0.1))
    goal = arm.workspace.goal
    for _ in range(15):
        env.step(action_of(control))
    np.testing.assert_array_equal(arm.workspace.goal.position, goal.position)
    moved = arm.tcp_pose()
    assert moved[2, 3] - start[2, 3] == pytest.approx(0.2, abs=0.01)
    turned = moved[:3, :3] @ start[:3, :3].T
    assert math.atan2(turned[1, 0], turned[0, 0]) == pytest.approx(0.4, abs=0.05)


@pytest.mark.parametrize("control", DELTAS)
def test_targets_stay_in_the_box_and_near_the_hand(control: str) -> None:
    env = steps_env(control, delta_position_m=0.1)
    rng = np.random.default_rng(0)
    low, high = env.action_space.low, env.action_space.high  # type: ignore[attr-defined]
    for k in range(80):
        if k % 8 == 0:
            action = np.where(rng.random(low.shape) < 0.5, low, high)
            action[:, 3:-1] = rng.uniform(low, high)[:, 3:-1]
        before = [arm.tcp_pose() for arm in arms_of(env)]
        env.step(action)
        for arm, pose in zip(arms_of(env), before, strict=True):
            goal = arm.workspace.goal
            assert np.all((goal.position >= LOWEST_M) & (goal.position <= HIGHEST_M))
            ahead = np.linalg.norm(goal.position - pose[:3, 3])
            assert ahead <= LEASH_STEPS * 0.1 + 1e-9
            cosine = 0.5 * (np.trace(goal.rotation.T @ pose[:3, :3]) - 1.0)
            assert math.acos(max(-1.0, cosine)) <= LEASH_STEPS * 0.25 + 1e-6


def test_the_gripper_closes_at_minus_one_and_opens_at_one() -> None:
    env = steps_env()
    action = action_of("delta_ee_pose")
    for value, opening_m in ((-1.0, 0.0), (0.0, 0.05), (1.0, 0.1)):
        action[:, -1] = value
        env.step(action)
        assert [arm.opening_m for arm in arms_of(env)] == pytest.approx([opening_m] * 2)


@pytest.mark.parametrize("control", ["ee_pose", "delta_ee_pose", "joint_velocity"])
def test_clipping_does_what_the_bounds_would(control: str) -> None:
    rng = np.random.default_rng(0)
    clipping = steps_env(control, clip_actions=True)
    strict = steps_env(control)
    space = strict.action_space
    for _ in range(5):
        wild = rng.uniform(-20.0, 20.0, space.shape)
        clipping.step(wild)
        with pytest.raises(InvalidActionError, match="clip_actions=True"):
            strict.step(wild)
        strict.step(np.clip(wild, space.low, space.high))  # type: ignore[attr-defined]
    assert clipping.state_hash() == strict.state_hash()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_not_clipped(bad: float) -> None:
    env = steps_env(clip_actions=True)
    action = action_of("delta_ee_pose")
    action[1, 2] = bad
    before = env.state_hash()
    with pytest.raises(InvalidActionError, match=r"dz of robot_1 is .*\[-1, 1\]"):
        env.step(action)
    with pytest.raises(InvalidActionError, match=r"shape \(2, 6\).*gripper"):
        env.step(action[:, :6])
    assert env.state_hash() == before


@pytest.mark.parametrize("control", ["ee_pose_rot6d", "delta_ee_pose_rot6d"])
def test_parallel_columns_are_refused_with_a_way_out(control: str) -> None:
    env = steps_env(control)
    before = env.state_hash()
    with pytest.raises(InvalidActionError, match=r"robot_0 .*\(1, 0, 0, 0, 1, 0\)"):
        env.step(np.zeros((2, 10)))
    assert env.state_hash() == before


@pytest.mark.parametrize(
    ("option", "value"),
    [("delta_position_m", 0.0), ("delta_rotation_rad", 2.0), ("clip_actions", 1)],
)
def test_impossible_options_are_refused(option: str, value: Any) -> None:
    with pytest.raises(InvalidConfigError, match=option):
        steps_env(**{option: value})
