"""Cameras: conventions, and agreement with MuJoCo's own."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose
from lemma.scene.cameras import (
    Camera,
    CameraIntrinsics,
    FreeCamera,
)
from lemma.scene.rendering.model_cameras import add_camera, camera_from_model

# Above the table, looking straight down, with the image's top towards +y.
DOWN = Pose((0.3, -0.2, 2.0), (0.0, 1.0, 0.0, 0.0))


def compiled(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    number = st.floats(-1.0, 1.0)
    vector = [draw(number) for _ in range(4)]
    norm = math.sqrt(sum(v * v for v in vector))
    quaternion = tuple(v / norm for v in vector) if norm > 0.1 else (1.0, 0, 0, 0)
    position = (draw(number), draw(number), 2.0)
    width, height = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    lens = CameraIntrinsics(
        *(width, height, draw(st.floats(5, 900)), draw(st.floats(5, 900))),
        *(draw(st.floats(0, width)), draw(st.floats(0, height))),
    )
    return Camera("any", Pose(position, quaternion), lens)  # type: ignore[arg-type]


@given(cameras(), st.integers(0, 2**32 - 1))
def test_project_undoes_unproject(camera: Camera, seed: int) -> None:
    lens = camera.intrinsics
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.1, 5.0, (lens.height, lens.width))
    pixels, found = camera.project(camera.unproject(depth).reshape(-1, 3))
    v, u = np.mgrid[: lens.height, : lens.width]
    np.testing.assert_allclose(pixels, np.stack([u, v], -1).reshape(-1, 2), atol=1e-8)
    np.testing.assert_allclose(found, depth.ravel(), rtol=1e-12)


def test_axes_of_the_image() -> None:
    lens = CameraIntrinsics.from_fovy(math.pi / 2, 640, 480)
    camera = Camera("down", DOWN, lens)
    at = [[0.3, -0.2, 0], [0.4, -0.2, 0], [0.3, -0.1, 0]]
    pixels, depth = camera.project(at)
    np.testing.assert_allclose(depth, 2.0)
    # The middle of 640 x 480 pixels whose first centre is (0, 0).
    np.testing.assert_allclose(pixels[0], [319.5, 239.5])
    np.testing.assert_allclose(pixels[1] - pixels[0], [12.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(pixels[2] - pixels[0], [0.0, -12.0], atol=1e-9)


def test_field_of_view_spans_the_image() -> None:
    lens = CameraIntrinsics.from_fovy(1.0, 64, 48)
    assert lens.fovy_rad == pytest.approx(1.0)
    edge = 2.0 * math.tan(0.5)
    pixels, _ = Camera("down", DOWN, lens).project(
        [[0.3, -0.2 + edge, 0], [0.3, -0.2 - edge, 0]]
    )
    np.testing.assert_allclose(pixels[:, 1], [-0.5, 47.5])


def test_points_behind_have_no_pixel() -> None:
    camera = Camera("down", DOWN, CameraIntrinsics.from_fovy(1.0, 64, 48))
    pixels, depth = camera.project([[0.0, 0.0, 2.5], [0.0, 0.0, 2.0]])
    assert np.isnan(pixels).all()
    np.testing.assert_allclose(depth, [-0.5, 0.0], atol=1e-12)


def test_unproject_knows_no_point_where_nothing_is_seen() -> None:
    camera = Camera("down", DOWN, CameraIntrinsics.from_fovy(1.0, 3, 2))
    depth = np.array([[0.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
    points = camera.unproject(depth)
    np.testing.assert_array_equal(np.isnan(points).any(-1), depth == 0)


def test_unproject_names_both_shapes() -> None:
    camera = Camera("down", DOWN, CameraIntrinsics.from_fovy(1.0, 64, 48))
    with pytest.raises(InvalidConfigError, match=r"\(64, 48\).*'down'.*\(48, 64\)"):
        camera.unproject(np.ones((64, 48)))


@pytest.mark.parametrize("degrees", [True, False])
def test_added_camera_is_read_back(degrees: bool) -> None:
    spec = mujoco.MjSpec()
    spec.compiler.degree = degrees
    pose = Pose((0.1, 0.2, 1.3), (0.1, 0.7, 0.5, 0.5))
    add_camera(spec, "eye", pose, 1.1)
    camera = camera_from_model(*compiled(spec), "eye", 320, 240)
    np.testing.assert_allclose(
        camera.world_from_camera.matrix(), pose.matrix(), atol=1e-9
    )
    assert camera.intrinsics.fovy_rad == pytest.approx(1.1)
    assert camera.name == "eye"


def test_unknown_camera_lists_the_valid_ones() -> None:
    spec = mujoco.MjSpec()
    add_camera(spec, "robot_0/camera", DOWN, 1.0)
    with pytest.raises(UnknownNameError, match="Did you mean 'robot_0/camera'"):
        camera_from_model(*compiled(spec), "robot_0/camra", 64, 48)


@pytest.mark.parametrize("kind", ["orthographic", "sensor"])
def test_other_lenses_are_refused(kind: str) -> None:
    spec = mujoco.MjSpec()
    camera = spec.worldbody.add_camera(name="odd")
    if kind == "orthographic":
        camera.proj = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC
    else:
        camera.sensor_size = [0.01, 0.01]
        camera.resolution = [64, 48]
        camera.focal_pixel = [50, 50]
    with pytest.raises(InvalidConfigError, match="'odd' is orthographic or has"):
        camera_from_model(*compiled(spec), "odd", 64, 48)


@pytest.mark.parametrize(
    ("fovy", "width", "height"), [(0.0, 4, 4), (4.0, 4, 4), (1.0, 0, 4)]
)
def test_impossible_lenses_are_refused(fovy: float, width: int, height: int) -> None:
    with pytest.raises(InvalidConfigError, match="must"):
        CameraIntrinsics.from_fovy(fovy, width, height)


@pytest.mark.parametrize("azimuth", [-120.0, 0.0, 75.0])
@pytest.mark.parametrize("elevation", [-89.0, -30.0, 10.0])
def test_free_camera_stands_where_mujoco_puts_it(
    azimuth: float, elevation: float
) -> None:
    free = FreeCamera((0.1, -0.2, 0.3), 1.7, azimuth, elevation)
    model, data = compiled(mujoco.MjSpec())
    view = mujoco.MjvCamera()
    view.lookat[:], view.distance = free.lookat, free.distance
    view.azimuth, view.elevation = azimuth, elevation
    scene = mujoco.MjvScene(model, maxgeom=10)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, view, everything, scene
    )
    eyes = scene.camera
    matrix = free.camera(64, 48).world_from_camera.matrix()
    middle = (np.array(eyes[0].pos) + np.array(eyes[1].pos)) / 2
    np.testing.assert_allclose(matrix[:3, 3], middle, atol=1e-6)
    np.testing.assert_allclose(matrix[:3, 2], eyes[0].forward, atol=1e-6)
    np.testing.assert_allclose(matrix[:3, 1], -np.array(eyes[0].up), atol=1e-6)
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)
