"""Control modes: they do what they are told, and never more than a robot can."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from physics_steps import each_step
from tiers import MODES, slow_but

import lemma
from lemma.core.errors import ResetNeededError
from lemma.core.poses import FloatArray, Pose, matrix_from_quaternion
from lemma.env.control.modes import CONTROLS
from lemma.env.control.rotations import (
    axis_angle_from_quaternion,
    rot6d_from_quaternion,
)
from lemma.env.control_env import ControlEnv
from lemma.robots.reach import reach_of
from lemma.robots.ur.kinematics import top_down
from lemma.scene.build import TICK_S
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.scene import Scene

ROTATIONS: dict[str, Any] = {
    "ee_pose": lambda quaternion: quaternion,
    "ee_pose_axis_angle": axis_angle_from_quaternion,
    "ee_pose_rot6d": rot6d_from_quaternion,
}

WAYPOINTS = {
    "ee_waypoint": ROTATIONS["ee_pose"],
    "ee_waypoint_rot6d": ROTATIONS["ee_pose_rot6d"],
}


def control_env(control: str, task: str = "stack", **options: Any) -> ControlEnv:
    env = lemma.make(task, control=control, **{"split": "test", "index": 0, **options})
    assert isinstance(env, ControlEnv)
    return env


def scene_of(env: ControlEnv) -> Scene:
    return env.episode.simulation.scene


def resting(env: ControlEnv) -> FloatArray:
    """Return an action that keeps every arm where it waits."""
    rows = []
    for arm in env.episode.simulation.arms.values():
        still = {
            "joint_position": [*arm.park.tolist(), 0.1],
            "joint_velocity": [0.0] * 6 + [0.1],
            "joint_torque": [0.0] * 6 + [0.1],
            "delta_ee_pose": [0.0] * 6 + [1.0],
            "delta_ee_pose_rot6d": [0.0] * 3 + [1, 0, 0, 0, 1, 0] + [1.0],
        }
        pose = Pose.from_matrix(arm.tcp_pose())
        for name, written in ROTATIONS.items():
            still[name] = [*pose.position, *written(pose.quaternion), 0.1]
        base = np.linalg.inv(arm.robot.world_from_base)
        own = Pose.from_matrix((base @ arm.tcp_pose()).astype(float))
        for name, written in WAYPOINTS.items():
            still[name] = [*own.position, *written(own.quaternion), 0.1]
        rows.append(still[env.config.control])
    return np.array(rows)


def pose_row(matrix: FloatArray) -> list[float]:
    pose = Pose.from_matrix(matrix)
    return [*pose.position, *pose.quaternion]


@contextmanager
def watching(env: ControlEnv) -> Iterator[list[FloatArray]]:
    """Record, in every physics step, speeds and efforts over their limits."""
    scene, records = scene_of(env), []

    def look() -> None:
        for robot in scene.robots:
            speeds = np.abs(scene.data.qvel[robot.dof]) / robot.arm.velocity_limits
            efforts = scene.data.actuator_force[robot.ctrl] / robot.arm.effort_limits
            records.append(np.array([speeds.max(), np.abs(efforts).max()]))

    with each_step(scene, look):
        yield records


def wild_actions(env: ControlEnv, seed: int, steps: int) -> list[FloatArray]:
    """Return random and extreme actions, each kept up for a while."""
    rng = np.random.default_rng(seed)
    low, high = env.action_layout.box().low, env.action_layout.box().high
    actions: list[FloatArray] = []
    while len(actions) < steps:
        action = rng.uniform(low, high)
        if rng.random() < 0.5:
            corner = np.where(rng.random(low.shape) < 0.5, low, high)
            # Columns at a corner can be parallel, and are then no rotation.
            free = [name[:1] == "r" for name in env.action_layout.columns]
            action = np.where(free, action, corner)
        actions += [action] * int(rng.choice([1, 3, 12]))
    return actions[:steps]


@pytest.mark.parametrize("index", slow_but(range(3), 0))
@pytest.mark.parametrize("control", slow_but(CONTROLS, *MODES))
def test_no_command_exceeds_what_the_robots_can_or_rams_the_table(
    control: str, index: int
) -> None:
    env = control_env(control, "hook_stack", index=index)
    env.reset()
    scene, deepest = scene_of(env), 0.0
    with watching(env) as records:
        for action in wild_actions(env, index, 120):
            env.step(action)
            for contact in scene.data.contact[: scene.data.ncon]:
                names = [scene.model.geom(geom).name for geom in contact.geom]
                if "table" in names and any("robot" in name for name in names):
                    deepest = min(deepest, float(contact.dist))
    assert deepest > -0.002
    speed, effort = np.max(records, axis=0)
    assert speed <= 1.0
    assert effort <= 1.0 + 1e-9
    # They were really driven hard.
    assert speed > (0.7 if "delta" in control else 0.8)


@pytest.mark.parametrize("control", slow_but(CONTROLS, *MODES))
def test_resting_arms_stay(control: str) -> None:
    env = control_env(control)
    layout = env.action_layout
    assert layout.rows == ("robot_0", "robot_1")
    assert layout.columns[-1] == ("gripper" if "delta" in control else "opening")
    assert env.action_space.shape == layout.shape == (2, len(layout.columns))
    first, _ = env.reset()
    action = resting(env)
    for _ in range(40):
        observation, *_, info = env.step(action)
    moved = np.abs(observation["agent_pos"] - first["agent_pos"]).max()
    assert moved < (0.02 if "ee_" in control else 1e-3)
    if "ee_" not in control:
        assert info["idle_s"] == pytest.approx({"robot_0": 2.0, "robot_1": 2.0})


@pytest.mark.parametrize("control", WAYPOINTS)
@pytest.mark.parametrize("side", slow_but([-1.0, 1.0], 1.0))
def test_waypoints_all_round_the_base_are_reached(control: str, side: float) -> None:
    env = control_env(control, "pass")
    env.reset()
    action = resting(env)
    arms = tuple(env.episode.simulation.arms.values())
    for bearing in (-1.8, 0.0, 1.8, -0.9):
        for row, arm in zip(action, arms, strict=True):
            radius_m = 0.6 * reach_of(arm.robot.arm.name).travel_m
            turned = side * bearing
            x, y = radius_m * math.cos(turned), radius_m * math.sin(turned)
            pose = Pose.from_matrix(top_down(x, y, 0.3, turned))
            row[:-1] = *pose.position, *WAYPOINTS[control](pose.quaternion)
        for _ in range(100):
            env.step(action)
        for row, arm in zip(action, arms, strict=True):
            own = np.linalg.solve(arm.robot.world_from_base, arm.tcp_pose())
            assert math.dist(own[:3, 3], row[:3]) < 0.005


def test_only_who_moves_is_busy() -> None:
    env = control_env("joint_velocity")
    env.reset()
    action = resting(env)
    action[1, 0] = 0.5
    for _ in range(20):
        *_, info = env.step(action)
    assert info["elapsed_s"] == pytest.approx(1.0)
    assert info["idle_s"]["robot_0"] == pytest.approx(1.0)
    assert info["idle_s"]["robot_1"] < 0.05


def test_joint_positions_are_reached_and_held() -> None:
    env = control_env("joint_position")
    env.reset()
    action = resting(env)
    action[:, :6] += [0.6, -0.2, 0.3, -0.4, 0.5, 1.0]
    action[:, 6] = 0.03
    for _ in range(40):
        observation, *_ = env.step(action)
    assert np.abs(observation["agent_pos"] - action.reshape(-1)).max() < 2e-3
    assert np.abs(observation["agent_vel"]).max() < 1e-2


def test_joint_speeds_are_reached() -> None:
    env = control_env("joint_velocity")
    env.reset()
    action = resting(env)
    wanted = [0.5, -0.2, 0.2, 0.3, -0.6, 1.0]
    action[:, :6] = wanted
    for _ in range(10):
        observation, *_ = env.step(action)
    rates = observation["agent_vel"].reshape(2, 7)[:, :6]
    assert np.abs(rates - wanted).max() < 0.02


def test_joints_stop_at_the_end_of_their_range() -> None:
    env = control_env("joint_velocity")
    env.reset()
    action = resting(env)
    action[:, 5] = 3.0
    for _ in range(80):
        observation, *_ = env.step(action)
    last = observation["agent_pos"].reshape(2, 7)[:, 5]
    assert np.all((last > math.tau - 0.05) & (last <= math.tau + 1e-3))


def test_torque_accelerates_by_the_inertia() -> None:
    env = control_env("joint_torque", control_hz=100)
    env.reset()
    action = resting(env)
    action[0, 5] = 5.0
    observation, *_ = env.step(action)
    arm = scene_of(env).robots[0].arm
    rate = float(observation["agent_vel"][5])
    # The last joint turns little more than its own rotor.
    assert rate == pytest.approx(0.01 * 5.0 / arm.armature[5], rel=0.05)


@pytest.mark.parametrize("control", ROTATIONS)
def test_poses_are_reached_however_they_are_written(control: str) -> None:
    env = control_env(control)
    env.reset()
    action = resting(env)
    targets = []
    for i, robot in enumerate(scene_of(env).robots):
        reach = reach_of(robot.arm.name).travel_m
        base = robot.placement.base
        x = base.x + 0.6 * reach * math.cos(base.yaw)
        y = base.y + 0.6 * reach * math.sin(base.yaw)
        targets.append(top_down(x, y, 0.25, base.yaw + 0.5))
        pose = Pose.from_matrix(targets[-1])
        action[i, :3] = pose.position
        action[i, 3:-1] = ROTATIONS[control](pose.quaternion)
        if control == "ee_pose":
            # Any length of a quaternion will do.
            action[i, 3:7] *= 0.3
    for _ in range(80):
        env.step(action)
    for arm, target in zip(env.episode.simulation.arms.values(), targets, strict=True):
        assert np.abs(arm.tcp_pose() - target).max() < 5e-3


def test_arms_are_aimed_with_the_posture_that_they_would_choose() -> None:
    env = control_env("ee_pose", "hook")
    env.reset()
    rng = np.random.default_rng(0)
    layout = env.action_layout
    arms, found = list(env.episode.simulation.arms.values()), 0
    for _ in range(120):
        action = rng.uniform(layout.low, layout.high, layout.shape)
        action[:, 3:7] = np.eye(4)[1] + rng.normal(0.0, 0.1, (len(arms), 4))
        env.controller.command(action)
        for arm, row in zip(arms, action, strict=True):
            pose = np.eye(4)
            pose[:3, :3] = matrix_from_quaternion(row[3:7] / math.hypot(*row[3:7]))
            pose[:3, 3] = row[:3]
            posture = arm.solve_posture(pose)
            found += posture is not None
            wanted = arm.state[0] if posture is None else posture
            goal = arm.workspace.goal
            assert np.allclose(goal.posture, wanted, atol=1e-9)
            assert np.allclose(goal.rotation, pose[:3, :3], atol=1e-12)
            assert np.allclose(goal.position, pose[:3, 3], atol=1e-12)
            assert goal.target_weight == 1.0
    assert 10 < found < 240


def test_a_cube_can_be_picked_up_with_poses() -> None:
    # The arm that reaches it waits on its side.
    env = control_env("ee_pose", "pass", index=1)
    _, info = env.reset()
    scene = scene_of(env)
    (goal,) = env.instance.goal.pairs
    cube = scene.pose2(goal[0])
    i, robot = next(
        (i, robot)
        for i, robot in enumerate(scene.robots)
        if reach_of(robot.arm.name).margin(robot.placement.base, cube.x, cube.y) > 0.0
    )
    action = resting(env)
    # Over the cube, down, close, up again.
    for z, opening, steps in (
        (0.20, 0.1, 70),
        (CUBE_EDGE_M / 2, 0.1, 50),
        (CUBE_EDGE_M / 2, 0.0, 15),
        (0.25, 0.0, 40),
    ):
        action[i, :7] = pose_row(top_down(cube.x, cube.y, z, cube.yaw))
        action[i, 7] = opening
        for _ in range(steps):
            *_, info = env.step(action)
    assert env.episode.simulation.held() == {robot.name: goal[0]}
    assert info["state"][goal[0]][2] > 0.2


def test_success_ends_the_episode_when_it_has_lasted() -> None:
    env = control_env("joint_position")
    env.reset()
    scene = scene_of(env)
    (goal,) = env.instance.goal.pairs
    below = scene.pose(goal[1])
    x, y, z = below.position
    scene.set_pose(goal[0], Pose((x, y, z + CUBE_EDGE_M), below.quaternion))
    action = resting(env)
    rewards: list[float] = []
    ends: list[bool] = []
    while not any(ends):
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        ends.append(terminated)
        assert not truncated
    assert rewards == [0.0] * (len(rewards) - 1) + [1.0]
    assert 10 <= len(rewards) <= 14
    assert info["is_success"]
    assert info["progress"] == 1.0
    with pytest.raises(ResetNeededError):
        env.step(action)


@pytest.mark.parametrize("hz", [10, 20, 50, 100])
def test_control_rate_is_the_one_asked_for(hz: int) -> None:
    env = control_env("joint_velocity", control_hz=hz)
    env.reset()
    for _ in range(3):
        *_, info = env.step(resting(env))
    assert info["elapsed_s"] == pytest.approx(3.0 / hz)
    assert env.metadata["render_fps"] == hz


def test_observers_see_every_tick_and_change_nothing() -> None:
    quiet, watched = (control_env("ee_pose", "pass") for _ in range(2))
    for env in (quiet, watched):
        env.reset()
    ticks: list[float] = []
    simulation = watched.episode.simulation
    simulation.observers.append(lambda: ticks.append(simulation.time_s))
    for action in wild_actions(quiet, 3, 20):
        one, other = (env.step(action)[4] for env in (quiet, watched))
        assert (one["progress"], one["idle_s"]) == (other["progress"], other["idle_s"])
    assert np.diff(ticks) == pytest.approx(np.full(99, TICK_S))
    assert quiet.state_hash() == watched.state_hash()
