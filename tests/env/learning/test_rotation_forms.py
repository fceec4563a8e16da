"""Rotations come back from every way of writing them."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from lemma.core.poses import matrix_from_quaternion
from lemma.env.control.rotations import (
    Quaternion,
    axis_angle_from_quaternion,
    compose,
    quaternion_from_axis_angle,
    quaternion_from_rot6d,
    rot6d_from_quaternion,
)

numbers = st.floats(-1.0, 1.0)


@st.composite
def quaternions(draw: st.DrawFn) -> Quaternion:
    raw = draw(st.tuples(numbers, numbers, numbers, numbers))
    length = math.hypot(*raw)
    assume(length > 1e-2)
    w, x, y, z = (v / length for v in raw)
    return (w, x, y, z)


def assert_same(first: Quaternion | None, second: Quaternion) -> None:
    assert first is not None
    found, expected = map(matrix_from_quaternion, (first, second))
    np.testing.assert_allclose(found, expected, atol=1e-7)


@given(quaternions())
def test_axis_and_angle_come_back(quaternion: Quaternion) -> None:
    vector = axis_angle_from_quaternion(quaternion)
    assert math.hypot(*vector) <= math.pi + 1e-9
    assert_same(quaternion_from_axis_angle(vector), quaternion)


@given(quaternions())
def test_six_numbers_come_back_and_are_columns(quaternion: Quaternion) -> None:
    six = rot6d_from_quaternion(quaternion)
    matrix = matrix_from_quaternion(quaternion)
    np.testing.assert_array_equal(np.reshape(six, (2, 3)).T, matrix[:, :2])
    assert_same(quaternion_from_rot6d(six), quaternion)


@given(quaternions(), st.floats(0.1, 5.0), st.floats(0.1, 5.0), numbers)
def test_six_numbers_need_be_neither_long_nor_orthogonal(
    quaternion: Quaternion, first: float, second: float, shear: float
) -> None:
    a, b = np.reshape(rot6d_from_quaternion(quaternion), (2, 3))
    assert_same(
        quaternion_from_rot6d([*first * a, *second * b + shear * a]), quaternion
    )


@given(quaternions(), st.floats(-4.0, 4.0))
def test_parallel_columns_are_no_rotation(quaternion: Quaternion, by: float) -> None:
    a = rot6d_from_quaternion(quaternion)[:3]
    assert quaternion_from_rot6d([*a, *(by * v for v in a)]) is None
    assert quaternion_from_rot6d([0.0, 0.0, 0.0, *a]) is None


@given(quaternions(), quaternions())
def test_composing_is_multiplying_matrices(a: Quaternion, b: Quaternion) -> None:
    product = matrix_from_quaternion(a) @ matrix_from_quaternion(b)
    found = matrix_from_quaternion(compose(a, b))
    np.testing.assert_allclose(found, product, atol=1e-12)


def test_a_quarter_turn_about_the_vertical() -> None:
    quaternion = quaternion_from_axis_angle((0.0, 0.0, math.pi / 2))
    assert rot6d_from_quaternion(quaternion) == pytest.approx((0, 1, 0, -1, 0, 0))
    assert quaternion_from_axis_angle((0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0, 0.0)
