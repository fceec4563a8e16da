"""Poses compose, invert and round-trip between their representations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.poses import (
    FloatArray,
    Pose,
    Pose2,
    matrix_from_quaternion,
    quaternion_from_matrix,
    wrap,
)

metres = st.floats(-3.0, 3.0)
angles = st.floats(-10.0, 10.0)
planar = st.builds(Pose2, metres, metres, angles)
components = st.floats(-1.0, 1.0)
quaternions = (
    st.tuples(components, components, components, components)
    .filter(lambda q: math.hypot(*q) > 1e-3)
    .map(lambda q: tuple(v / math.hypot(*q) for v in q))
)


def planar_matrix(pose: Pose2) -> FloatArray:
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    return np.array([[cos, -sin, pose.x], [sin, cos, pose.y], [0, 0, 1.0]])


def assert_same(a: Pose2, b: Pose2) -> None:
    assert planar_matrix(a) == pytest.approx(planar_matrix(b), abs=1e-9)


@given(planar, planar)
def test_composition_is_the_product_of_the_matrices(a: Pose2, b: Pose2) -> None:
    product = planar_matrix(a) @ planar_matrix(b)
    assert planar_matrix(a @ b) == pytest.approx(product, abs=1e-9)


@given(planar)
def test_inverse_undoes(pose: Pose2) -> None:
    assert_same(pose @ pose.inverse(), Pose2(0.0, 0.0))
    assert_same(pose.inverse() @ pose, Pose2(0.0, 0.0))


@given(st.floats(-1e3, 1e3))
def test_wrap_changes_an_angle_by_whole_turns_only(angle: float) -> None:
    wrapped = wrap(angle)
    assert -math.pi <= wrapped < math.pi
    turns = (angle - wrapped) / math.tau
    assert turns == pytest.approx(round(turns), abs=1e-9)


def test_wrap_of_half_a_turn_is_the_lower_end() -> None:
    assert wrap(math.pi) == wrap(-math.pi) == -math.pi


@pytest.mark.parametrize("turns", [-3, -1, 1, 3])
@pytest.mark.parametrize("side", [-math.inf, math.inf])
def test_wrap_stays_in_range_where_rounding_bites(turns: int, side: float) -> None:
    angle = math.nextafter(turns * math.pi, side)
    assert -math.pi <= wrap(angle) < math.pi


@given(planar)
def test_rounded_is_near_and_stays_as_it_is(pose: Pose2) -> None:
    rounded = pose.rounded()
    assert rounded.distance(pose) <= 1e-4
    assert abs(rounded.yaw - pose.yaw) <= 0.5001e-4
    assert rounded.rounded() == rounded


@given(quaternions)
def test_quaternion_to_matrix_and_back(q: tuple[float, float, float, float]) -> None:
    matrix = matrix_from_quaternion(q)
    assert matrix.T @ matrix == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    back = quaternion_from_matrix(matrix)
    assert math.hypot(*back) == pytest.approx(1.0)
    assert back[0] >= 0.0
    # Both signs are the same rotation.
    assert abs(sum(a * b for a, b in zip(q, back, strict=True))) == pytest.approx(1.0)
    assert matrix_from_quaternion(back) == pytest.approx(matrix, abs=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [0.3, math.pi / 2, math.pi, -2.0])
def test_quaternions_turn_about_an_axis(axis: int, angle: float) -> None:
    q = [math.cos(angle / 2), 0.0, 0.0, 0.0]
    q[1 + axis] = math.sin(angle / 2)
    matrix = matrix_from_quaternion((q[0], q[1], q[2], q[3]))
    before, after = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    turned = math.cos(angle) * before + math.sin(angle) * after
    assert matrix @ before == pytest.approx(turned, abs=1e-12)
    assert matrix @ np.eye(3)[axis] == pytest.approx(np.eye(3)[axis], abs=1e-12)


@given(st.tuples(metres, metres, metres), quaternions)
def test_pose_to_matrix_and_back(
    position: tuple[float, float, float], q: tuple[float, float, float, float]
) -> None:
    matrix = Pose(position, q).matrix()
    assert matrix[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    back = Pose.from_matrix(matrix)
    assert back.position == position
    assert back.matrix() == pytest.approx(matrix, abs=1e-9)
