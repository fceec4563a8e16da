"""Kinematics against the maker's table, against itself and against MuJoCo."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.poses import FloatArray, Pose2
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.ur.arms import ARMS, LINKS
from lemma.robots.ur.build import add_arm
from lemma.robots.ur.kinematics import (
    forward,
    frames,
    inverse,
    invert,
    multiply,
    point_jacobian,
    top_down,
)

ARM_NAMES = ("ur5", "ur10")

# a [m], d [m], alpha [rad], as Universal Robots publishes them.
PUBLISHED = {
    "ur5": (
        (0.0, 0.089159, math.pi / 2),
        (-0.425, 0.0, 0.0),
        (-0.39225, 0.0, 0.0),
        (0.0, 0.10915, math.pi / 2),
        (0.0, 0.09465, -math.pi / 2),
        (0.0, 0.0823, 0.0),
    ),
    "ur10": (
        (0.0, 0.1273, math.pi / 2),
        (-0.612, 0.0, 0.0),
        (-0.5723, 0.0, 0.0),
        (0.0, 0.163941, math.pi / 2),
        (0.0, 0.1157, -math.pi / 2),
        (0.0, 0.0922, 0.0),
    ),
}


def translation(x: float, y: float, z: float) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def rotation(axis: str, angle: float) -> FloatArray:
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    i, j = {"x": (1, 2), "z": (0, 1)}[axis]
    matrix[i, i] = matrix[j, j] = cos
    matrix[i, j], matrix[j, i] = -sin, sin
    return matrix


def published_frames(arm: str, q: FloatArray) -> list[FloatArray]:
    result = [np.eye(4)]
    for (a, d, alpha), angle in zip(PUBLISHED[arm], q, strict=True):
        link = rotation("z", angle) @ translation(a, 0, d) @ rotation("x", alpha)
        result.append(result[-1] @ link)
    return result


def some_joints(count: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, 6))


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_frames_are_those_of_the_published_links(arm: str) -> None:
    base = translation(-0.7, 0.2, 0.0) @ rotation("z", 0.4)
    out = np.empty((7, 4, 4))
    for q in some_joints(50, seed=1):
        frames(ARMS[arm].dh, base, q, out)
        for frame, expected in zip(out, published_frames(arm, q), strict=True):
            assert np.abs(frame - base @ expected).max() < 1e-12
        flange = published_frames(arm, q)[6]
        assert np.abs(forward(ARMS[arm].dh, q) - flange).max() < 1e-12


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_frames_are_those_of_the_compiled_bodies(arm: str) -> None:
    spec = mujoco.MjSpec()
    add_arm(spec, ARMS[arm], "robot_0", Pose2(-0.7, 0.2, 0.4), "red")
    model = spec.compile()
    data = mujoco.MjData(model)
    base = translation(-0.7, 0.2, 0.0) @ rotation("z", 0.4)
    out = np.empty((7, 4, 4))
    for q in some_joints(20, seed=2):
        data.qpos[:6] = q
        mujoco.mj_kinematics(model, data)
        frames(ARMS[arm].dh, base, q, out)
        # The body that joint i moves sits at frame i - 1; the gripper at the flange.
        for i, link in enumerate(LINKS):
            body = data.body(f"robot_0/{link}")
            assert np.abs(body.xpos - out[i, :3, 3]).max() < 1e-9
            assert np.abs(body.xmat.reshape(3, 3)[:, 2] - out[i, :3, 2]).max() < 1e-9
        gripper = data.body("robot_0/gripper")
        assert np.abs(gripper.xpos - out[6, :3, 3]).max() < 1e-9
        assert np.abs(gripper.xmat.reshape(3, 3) - out[6, :3, :3]).max() < 1e-9
        tool = out[6, :3, 3] + TCP_OFFSET_M * out[6, :3, 2]
        assert np.abs(data.site("robot_0/tcp").xpos - tool).max() < 1e-9


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_inverse_branches_reach_the_pose_and_one_is_that_which_made_it(
    arm: str,
) -> None:
    dh, branches = ARMS[arm].dh, np.zeros(9, dtype=int)
    for q in some_joints(5_000, seed=3):
        flange = forward(dh, q)
        solutions = inverse(dh, flange)
        branches[len(solutions)] += 1
        for solution in solutions:
            assert np.abs(forward(dh, solution) - flange).max() < 1e-9
        assert (solutions >= -math.pi).all()
        assert (solutions < math.pi).all()
        # Half an angle's sine is zero for whole turns alone.
        assert np.abs(np.sin(0.5 * (solutions - q))).max(axis=1).min() < 1e-7
        gaps = np.abs(np.sin(0.5 * (solutions[:, None] - solutions[None]))).max(axis=2)
        assert (gaps + np.eye(len(solutions)) > 1e-7).all()
    assert branches[8] > 500
    assert branches[[2, 4, 6, 8]].sum() == 5_000


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_inverse_of_a_pose_out_of_reach_is_empty(arm: str) -> None:
    dh = ARMS[arm].dh
    assert inverse(dh, translation(3.0, 0.0, 0.3)).shape == (0, 6)
    # The wrist centre on the shoulder's axis: nearer than d4 it cannot come.
    on_axis = top_down(0.0, 0.0, 0.5, 0.0)
    assert inverse(dh, on_axis).shape == (0, 6)


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_inverse_at_the_wrist_singularity_leaves_joint_6_at_zero(arm: str) -> None:
    dh = ARMS[arm].dh
    flange = forward(dh, np.array([0.3, -1.2, 1.4, -0.5, 0.0, 0.7]))
    solutions = inverse(dh, flange)
    singular = [q for q in solutions if abs(math.sin(q[4])) < 1e-6]
    assert singular
    for q in singular:
        assert np.abs(forward(dh, q) - flange).max() < 1e-6


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_point_jacobian_is_the_derivative(arm: str) -> None:
    dh, step = ARMS[arm].dh, 1e-6
    base = translation(0.5, -0.1, 0.0) @ rotation("z", 2.0)
    local = np.array([0.05, -0.03, 0.11, 1.0])
    now, after, before = (np.empty((7, 4, 4)) for _ in range(3))
    jacobian = np.empty((3, 6))
    for q in some_joints(30, seed=6):
        frames(dh, base, q, now)
        for link in range(7):
            point_jacobian(now, link, (now[link] @ local)[:3], jacobian)
            for j in range(6):
                frames(dh, base, q + step * np.eye(6)[j], after)
                frames(dh, base, q - step * np.eye(6)[j], before)
                slope = ((after[link] - before[link]) @ local)[:3] / (2 * step)
                assert np.abs(jacobian[:, j] - slope).max() < 1e-8


@given(
    st.floats(-1, 1), st.floats(-1, 1), st.floats(0, 1), st.floats(-math.pi, math.pi)
)
def test_top_down_points_down_and_closes_along_y(
    x: float, y: float, z: float, yaw: float
) -> None:
    pose = top_down(x, y, z, yaw)
    assert pose[:3, 3].tolist() == [x, y, z]
    assert pose[:3, 2].tolist() == [0.0, 0.0, -1.0]
    heading = [math.cos(yaw), math.sin(yaw), 0.0]
    assert np.abs(pose[:3, 0] - heading).max() < 1e-15
    across = np.cross(pose[:3, 2], pose[:3, 0])
    assert np.abs(pose[:3, 1] - across).max() < 1e-15
    assert pose[3].tolist() == [0.0, 0.0, 0.0, 1.0]


def test_multiply_and_invert_agree_with_numpy() -> None:
    a, b = (published_frames("ur5", q)[6] for q in some_joints(2, seed=7))
    out = np.empty((4, 4))
    multiply(a, b, out)
    assert np.abs(out - a @ b).max() < 1e-14
    invert(a, out)
    assert np.abs(out - np.linalg.inv(a)).max() < 1e-12
