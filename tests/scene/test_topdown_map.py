"""The top-down map: steps and conventions of its raster, fusion of rendered cameras."""

import dataclasses
import math
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose
from lemma.scene.cameras import Camera, CameraImage, CameraIntrinsics, FreeCamera
from lemma.scene.raster import (
    RASTER,
    UNIT_M,
    MapImage,
    Raster,
    decode_depth,
    encode_depth,
)
from lemma.scene.rendering.model_cameras import add_camera
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.topdown_map import fuse

BLUE, GREEN, RED = (0.1, 0.1, 0.9, 1), (0.1, 0.8, 0.1, 1), (0.9, 0.1, 0.1, 1)
GREY = (0.4, 0.4, 0.4, 1)
CUBE_XY, PAD_XY = (0.204, 0.1), (-0.396, -0.3)
# One camera above each side of the table, overlapping in the middle.
VIEWS = (
    FreeCamera((-0.6, 0.0, 0.0), 1.6, 0.0, -70.0, 58.0),
    FreeCamera((0.6, 0.0, 0.0), 1.6, 180.0, -70.0, 58.0),
)


def table_scene() -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.stat.extent = 3.0
    spec.visual.map.znear, spec.visual.map.zfar = 0.05, 4.0
    spec.visual.headlight.ambient = [0.5, 0.5, 0.5]
    world = spec.worldbody
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    world.add_geom(
        name="table", type=box, size=[1.4, 1, 0.01], pos=[0, 0, -0.01], rgba=GREY
    )
    world.add_geom(name="floor", type=box, size=[4, 4, 0.01], pos=[0, 0, -0.7])
    world.add_geom(type=box, size=[0.025] * 3, pos=[*CUBE_XY, 0.025], rgba=BLUE)
    world.add_geom(
        type=cylinder, size=[0.06, 0.002, 0], pos=[*PAD_XY, 0.002], rgba=GREEN
    )
    for i, view in enumerate(VIEWS):
        eye = view.camera(8, 8)
        fovy = math.radians(view.fovy_deg)
        add_camera(spec, f"robot_{i}/camera", eye.world_from_camera, fovy)
    return spec


def photographs(spec: mujoco.MjSpec) -> list[CameraImage]:
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = Renderer()
    return [renderer.rgbd(model, data, f"robot_{i}/camera") for i in range(2)]


def looking_down(width: int, height: int, altitude: float = 1.0) -> Camera:
    pose = Pose((0.0, 0.0, altitude), (0.0, 1.0, 0.0, 0.0))
    lens = CameraIntrinsics(width, height, 1.0, 1.0, (width - 1) / 2, (height - 1) / 2)
    return Camera("down", pose, lens)


def area(fused: MapImage, channel: int) -> np.ndarray:
    """Return the cells in which one color channel dominates."""
    rgb = fused.rgb.astype(int)
    others = [c for c in range(3) if c != channel]
    return rgb[..., channel] > 1.6 * rgb[..., others].max(-1) + 10


def test_default_raster() -> None:
    raster = Raster()
    assert raster.size_m == pytest.approx((3.328, 3.328))
    assert raster.world_from_pixel(0, 0) == pytest.approx((-1.66, 1.66))
    assert raster.world_from_pixel(415, 415) == pytest.approx((1.66, -1.66))
    assert raster.pixel_from_world(0.001, -0.001) == (208, 208)
    assert raster.pixel_from_world(-1.663, 1.663) == (0, 0)
    assert raster.pixel_from_world(1.665, -1.665) == (416, 416)
    assert raster.pixel_from_world(-1.665, 1.665) == (-1, -1)


@given(st.integers(0, 415), st.integers(0, 415), st.floats(-0.49, 0.49))
def test_cells_and_positions_correspond(row: int, column: int, off: float) -> None:
    x, y = RASTER.world_from_pixel(row + off, column - off)
    assert RASTER.pixel_from_world(x, y) == (row, column)


@pytest.mark.render
def test_map_shows_objects_where_they_are() -> None:
    fused = fuse(photographs(table_scene()))
    assert fused.rgb.shape == (416, 416, 3)
    for xy, channel, height, square_m2 in (
        (CUBE_XY, 2, 0.05, 0.05**2),
        (PAD_XY, 1, 0.004, math.pi * 0.06**2),
    ):
        cell = RASTER.pixel_from_world(*xy)
        assert area(fused, channel)[cell]
        assert fused.height_m[cell] == pytest.approx(height, abs=1e-4)
        rows, columns = np.nonzero(
            area(fused, channel) & (np.abs(fused.height_m - height) < 1e-3)
        )
        # A cell whose edge is touched counts: half a cell more on each side.
        assert rows.mean() == pytest.approx(cell[0], abs=1)
        assert columns.mean() == pytest.approx(cell[1], abs=1)
        side = math.sqrt(len(rows)) * RASTER.cell_m
        assert side == pytest.approx(math.sqrt(square_m2), abs=1.5 * RASTER.cell_m)
    aside = RASTER.pixel_from_world(0.0, -0.1)
    assert fused.height_m[aside] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.render
def test_both_cameras_are_needed_and_agree() -> None:
    images = photographs(table_scene())
    left, right = (fuse([image]) for image in images)
    both = fuse(images)

    def near(one: MapImage, column: int) -> float:
        """How much is seen of a hundred columns, where the table is."""
        seen = one.coverage[80:-80]
        return float(np.roll(seen, -column, axis=1)[:, :100].mean())

    assert near(left, 0) > 0.5 > near(left, -100)
    assert near(right, -100) > 0.5 > near(right, 0)
    np.testing.assert_array_equal(
        both.coverage & ~(left.coverage | right.coverage), False
    )
    shared = left.coverage & right.coverage
    assert shared.sum() > 1000
    flat = shared & (np.abs(both.height_m) < 1e-3)
    assert np.abs(left.height_m - right.height_m)[flat].max() < 0.051
    np.testing.assert_allclose(
        both.height_m[shared],
        np.maximum(left.height_m, right.height_m)[shared],
        atol=1e-6,
    )


@pytest.mark.render
def test_table_has_no_holes_and_the_floor_does_not_count() -> None:
    fused = fuse(photographs(table_scene()))
    x, y = np.meshgrid(
        [RASTER.world_from_pixel(0, c)[0] for c in range(RASTER.columns)],
        [RASTER.world_from_pixel(r, 0)[1] for r in range(RASTER.rows)],
    )
    assert fused.coverage[(np.abs(x) < 0.9) & (np.abs(y) < 0.6)].all()
    beside = (np.abs(x) > 1.41) | (np.abs(y) > 1.01)
    assert not fused.coverage[beside].any()
    assert fused.height_m[~fused.coverage].max() == 0
    assert fused.rgb[~fused.coverage].max() == 0


@pytest.mark.render
def test_what_is_above_the_ceiling_is_dropped() -> None:
    spec = table_scene()
    lamp = mujoco.mjtGeom.mjGEOM_SPHERE
    spec.worldbody.add_geom(type=lamp, size=[0.1, 0, 0], pos=[-0.8, 0, 0.8], rgba=RED)
    images = photographs(spec)
    assert not area(fuse(images), 0).any()
    high = fuse(images, ceiling_m=1.0)
    assert area(high, 0).any()
    assert high.height_m.max() == pytest.approx(0.9, abs=0.005)


def small(depth: list[list[float]], altitude: float = 1.0) -> MapImage:
    """Fuse one image that has the map's own raster of one-metre cells."""
    array = np.array(depth, np.float32)
    rows, columns = array.shape
    color = np.arange(rows * columns * 3, dtype=np.uint8).reshape(rows, columns, 3)
    image = CameraImage(color, array, looking_down(columns, rows, altitude))
    return fuse([image], Raster(rows, columns, cell_m=1.0), ceiling_m=2.0)


def test_rows_and_columns_are_those_of_a_camera_that_looks_down() -> None:
    fused = small([[1.0, 1.0], [1.0, 1.0]])
    np.testing.assert_array_equal(fused.rgb.ravel(), np.arange(12))
    np.testing.assert_array_equal(fused.height_m, 0.0)
    assert fused.coverage.all()


def test_gap_takes_the_lower_of_two_opposite_neighbours() -> None:
    # The right neighbour is 0.5 m high (its depth of 0.5 moves it half a cell in).
    fused = small([[1.0, 0.0, 0.8]])
    np.testing.assert_allclose(fused.height_m, [[0.0, 0.0, 0.2]], atol=1e-6)
    np.testing.assert_array_equal(fused.rgb[0, 1], fused.rgb[0, 0])
    assert fused.coverage.all()


def test_wide_gaps_and_margins_stay_empty() -> None:
    np.testing.assert_array_equal(
        small([[1.0, 0.0, 0.0, 1.0]]).coverage, [[True, False, False, True]]
    )
    np.testing.assert_array_equal(small([[0.0, 1.0]]).coverage, [[False, True]])


def test_highest_point_counts_and_of_equals_the_first() -> None:
    camera = looking_down(1, 1)
    raster = Raster(1, 1, cell_m=1.0)

    def image(value: int, depth: float) -> CameraImage:
        color = np.full((1, 1, 3), value, np.uint8)
        return CameraImage(color, np.full((1, 1), depth, np.float32), camera)

    first = fuse([image(1, 0.9), image(2, 0.9), image(3, 0.95)], raster)
    assert first.rgb[0, 0, 0] == 1
    assert fuse([image(1, 0.9), image(2, 0.8)], raster).rgb[0, 0, 0] == 2


@pytest.mark.parametrize("depth", [0.0, -1.0, np.nan, np.inf])
def test_depths_that_mean_nothing_are_ignored(depth: float) -> None:
    assert not small([[depth]]).coverage.any()


def test_no_image_gives_an_empty_map() -> None:
    fused = fuse([], Raster(4, 5))
    assert not fused.coverage.any()
    assert fused.height_m.shape == (4, 5)


def test_images_of_another_size_are_refused() -> None:
    color, depth = np.zeros((2, 3, 3), np.uint8), np.ones((2, 3), np.float32)
    with pytest.raises(InvalidConfigError, match=r"'down'.*\(2, 3, 3\).*\(3, 2, 3\)"):
        fuse([CameraImage(color, depth, looking_down(2, 3))])


@pytest.mark.parametrize(
    "change", [{"rows": 0}, {"cell_m": 0.0}, {"cell_m": math.nan}, {"floor_m": 0.7}]
)
def test_impossible_rasters_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InvalidConfigError, match="must be"):
        fuse([], dataclasses.replace(RASTER, **change))


# --- The steps in which depths and heights are stored ---------------------------------


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
