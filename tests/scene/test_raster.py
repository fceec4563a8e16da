"""Depths and heights in the steps in which they are stored."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lemma.scene.raster import RASTER, UNIT_M, decode_depth, encode_depth


@given(st.floats(0.0001, 6.5))
def test_depth_is_kept_to_half_a_unit(depth_m: float) -> None:
    stored = encode_depth(np.array([depth_m], np.float32))
    # And the rounding of two numbers to float32: the one given and the one returned.
    rounding = float(np.spacing(np.float32(depth_m + UNIT_M)))
    assert abs(float(decode_depth(stored)[0]) - depth_m) <= 0.5 * UNIT_M + rounding
    assert encode_depth(decode_depth(stored)) == stored


def test_nothing_seen_stays_nothing_and_far_is_nothing() -> None:
    assert encode_depth([0.0, 6.5535, 6.5536, 50.0]).tolist() == [0, 65535, 0, 0]


@given(st.floats(-0.1, 0.6), st.booleans())
def test_height_is_kept_to_half_a_unit(height_m: float, covered: bool) -> None:
    stored = RASTER.encode_height(np.array([height_m], np.float32), np.array([covered]))
    assert (stored[0] > 0) == covered
    expected = height_m if covered else 0.0
    decoded = RASTER.decode_height(stored)
    assert abs(float(decoded[0]) - expected) <= 0.5005 * UNIT_M
    assert RASTER.encode_height(decoded, np.array([covered])) == stored


def test_every_stored_number_survives() -> None:
    depths = np.arange(65536, dtype=np.uint16)
    assert np.array_equal(encode_depth(decode_depth(depths)), depths)
    heights = np.arange(20_000, dtype=np.uint16)
    seen = heights > 0
    decoded = RASTER.decode_height(heights)
    assert np.array_equal(RASTER.encode_height(decoded, seen), heights)
