"""Pictures: that they show what is there, where it is, whatever was drawn before."""

import math
import threading

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose
from lemma.scene.cameras import Camera, CameraIntrinsics, FreeCamera
from lemma.scene.rendering import gl_context as canvas
from lemma.scene.rendering.model_cameras import add_camera, camera_from_model
from lemma.scene.rendering.renderer import Renderer, depth_from_buffer

pytestmark = pytest.mark.render

RED = (0.9, 0.1, 0.1, 1.0)
GREY = (0.5, 0.5, 0.5, 1.0)
CUBE_CENTRE = np.array([0.12, -0.07, 0.025])
CUBE_HALF = 0.025
# 2 m away, tilted, and rolled so that no edge runs along the pixels.
OBLIQUE = FreeCamera((0.1, 0.0, 0.0), 2.0, 33.0, -50.0, 40.0)


def table_scene(cube_rgba: tuple[float, ...] = RED) -> mujoco.MjSpec:
    """Return a table with a cube on it and a camera that looks from aside."""
    spec = mujoco.MjSpec()
    spec.stat.extent = 3.0
    spec.visual.map.znear, spec.visual.map.zfar = 0.05, 4.0
    world = spec.worldbody
    box = mujoco.mjtGeom.mjGEOM_BOX
    sun = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    world.add_light(type=sun, pos=[0, 0, 3], dir=[0.5, 0.5, -1], castshadow=True)
    world.add_geom(
        name="table", type=box, size=[1, 1, 0.01], pos=[0, 0, -0.01], rgba=GREY
    )
    cube = world.add_body(name="cube", pos=CUBE_CENTRE)
    cube.add_geom(name="cube", type=box, size=[CUBE_HALF] * 3, rgba=cube_rgba)
    eye = OBLIQUE.camera(8, 8)
    add_camera(spec, "eye", eye.world_from_camera, math.radians(OBLIQUE.fovy_deg))
    return spec


def compiled(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def mesh_scene(half: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a cube made of a mesh, seen from 1 m above its centre."""
    spec = mujoco.MjSpec()
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    spec.add_mesh(name="block", uservert=(np.array(corners) * half).ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="block")
    spec.stat.extent = 3.0
    spec.visual.map.znear = 0.05
    add_camera(spec, "eye", Pose((0, 0, 1.0), (0.0, 1.0, 0.0, 0.0)), 1.0)
    return compiled(spec)


def signed_distances(hull: ConvexHull, points: np.ndarray) -> np.ndarray:
    """Return distances to the hull's outline: positive outside [px]."""
    planes = hull.equations
    return (points @ planes[:, :2].T + planes[:, 2]).max(axis=1)


@pytest.mark.parametrize("size", [(640, 480), (321, 203), (203, 321)])
@pytest.mark.parametrize("view", ["eye", OBLIQUE, "calibrated"])
def test_cube_is_drawn_exactly_where_it_projects(
    size: tuple[int, int], view: str | FreeCamera
) -> None:
    model, data = compiled(table_scene())
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    drawn_by: str | FreeCamera | Camera = view
    if view == "calibrated":
        lens = CameraIntrinsics.from_shorter_side(0.6, *size)
        pose = OBLIQUE.camera(*size).world_from_camera
        camera = drawn_by = Camera("close", pose, lens)
    elif isinstance(view, str):
        camera = camera_from_model(model, data, view, *size)
    else:
        camera = view.camera(*size)
    corners, _ = camera.project(CUBE_CENTRE + CUBE_HALF * signs)
    geoms = Renderer(*size).segmentation(model, data, drawn_by)
    v, u = np.mgrid[: size[1], : size[0]]
    centres = np.stack([u, v], -1).reshape(-1, 2)
    distance = signed_distances(ConvexHull(corners), centres).reshape(v.shape)
    drawn = geoms == model.geom("cube").id
    # OpenGL paints a pixel if its centre is covered: off by 0.03 px at most.
    assert (distance < -0.03).sum() > 50
    assert drawn[distance < -0.03].all()
    assert not drawn[distance > 0.03].any()
    assert set(np.unique(geoms)) <= {-1, model.geom("table").id, model.geom("cube").id}


def test_depth_is_exact() -> None:
    model, data = compiled(table_scene())
    renderer = Renderer()
    image = renderer.rgbd(model, data, "eye")
    geoms = renderer.segmentation(model, data, "eye")
    points = image.camera.unproject(image.depth_m)
    on_table = geoms == model.geom("table").id
    assert 1.5 < image.depth_m[on_table].min() < 2.0 < image.depth_m[on_table].max()
    assert np.abs(points[on_table][:, 2]).max() < 1e-4
    inside = np.abs(points[geoms == model.geom("cube").id] - CUBE_CENTRE)
    assert np.abs(inside.max(axis=1) - CUBE_HALF).max() < 1e-4
    np.testing.assert_array_equal(image.depth_m == 0, geoms == -1)


def test_color_and_depth_are_upright_and_of_the_same_moment() -> None:
    model, data = compiled(table_scene())
    image = Renderer().rgbd(model, data, "eye")
    assert image.rgb.shape == (480, 640, 3)
    assert image.rgb.dtype == np.uint8
    assert image.depth_m.shape == (480, 640)
    assert image.depth_m.dtype == np.float32
    assert image.rgb.flags.c_contiguous
    assert image.depth_m.flags.c_contiguous
    (pixel,), (depth,) = image.camera.project([0.12, -0.07, 0.05])
    column, row = (round(float(value)) for value in pixel)
    red, green, _ = (int(value) for value in image.rgb[row, column])
    assert red > 2 * green
    # The pixel's centre lies up to half a pixel from the point.
    assert image.depth_m[row, column] == pytest.approx(depth, abs=0.003)


@pytest.mark.parametrize("depth", [0.15, 0.5, 2.0, 11.9])
def test_depth_buffer_is_inverted(depth: float) -> None:
    near, far = 0.15, 12.0
    buffer = np.array([near / depth * (far - depth) / (far - near), 0.0], np.float32)
    result = depth_from_buffer(buffer, near, far)
    assert result[0] == pytest.approx(depth, rel=1e-5)
    assert result[1] == 0.0


def test_nothing_of_an_earlier_scene_is_left() -> None:
    renderer = Renderer(64, 48)
    for half in (0.1, 0.2, 0.1, 0.3):
        image = renderer.rgbd(*mesh_scene(half), "eye")
        assert image.depth_m[24, 32] == pytest.approx(1.0 - half, abs=1e-4)


def test_same_scene_compiled_anew_gives_the_same_picture() -> None:
    renderer = Renderer()
    first = renderer.rgbd(*compiled(table_scene()), "eye")
    renderer.rgbd(*mesh_scene(0.1), "eye")
    again = renderer.rgbd(*compiled(table_scene()), "eye")
    other = Renderer().rgbd(*compiled(table_scene()), "eye")
    for image in (again, other):
        np.testing.assert_array_equal(image.rgb, first.rgb)
        np.testing.assert_array_equal(image.depth_m, first.depth_m)


def test_uploads_are_shared_between_scenes_that_differ_in_colors_and_poses() -> None:
    renderer = Renderer(64, 48)
    uploads = set()
    for green in (0.1, 0.5, 0.9):
        spec = table_scene((0.1, green, 0.1, 1.0))
        spec.body("cube").pos = [0.0, green / 10, CUBE_HALF]
        rgb = renderer.rgbd(*compiled(spec), "eye").rgb
        assert rgb[..., 1].max() > 0
        assert renderer._upload is not None
        uploads.add(id(renderer._upload.drawing))
    assert len(uploads) == 1


def textured(value: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = table_scene()
    flat = mujoco.mjtTexture.mjTEXTURE_2D
    pixels = np.full((4, 4, 3), value, np.uint8)
    texture = spec.add_texture(name="paint", type=flat, width=4, height=4, nchannel=3)
    texture.data = pixels.tobytes()
    material = spec.add_material(name="paint")
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "paint"
    spec.geom("table").material = "paint"
    return compiled(spec)


def test_a_changed_texture_is_seen() -> None:
    renderer = Renderer(64, 48)
    bright, dark = (renderer.rgbd(*textured(v), "eye").rgb.mean() for v in (255, 50))
    assert bright > 1.5 * dark


def test_a_changed_plane_is_seen() -> None:
    renderer = Renderer(320, 240)
    seen = []
    for half in (0.1, 0.4):
        spec = mujoco.MjSpec()
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(type=plane, size=[half, half, 0.1])
        spec.stat.extent = 3.0
        add_camera(spec, "eye", Pose((0, 0, 1.0), (0.0, 1.0, 0.0, 0.0)), 1.0)
        seen.append((renderer.rgbd(*compiled(spec), "eye").depth_m > 0).sum())
    assert seen[1] == pytest.approx(16 * seen[0], rel=0.1)


def test_old_uploads_are_freed_and_made_again() -> None:
    first = Renderer(64, 48)
    model, data = mesh_scene(0.123)
    before = first.rgbd(model, data, "eye").depth_m
    for i in range(canvas.POOL_SIZE + 1):
        Renderer(32, 32).rgbd(*mesh_scene(0.1 + 0.01 * i), "eye")
    assert first._upload is not None
    assert first._upload.drawing is None
    np.testing.assert_array_equal(first.rgbd(model, data, "eye").depth_m, before)
    assert canvas._process is not None
    assert len(canvas._process.pool) == canvas.POOL_SIZE


def test_collision_shapes_and_sites_are_hidden() -> None:
    spec = table_scene()
    plain = Renderer(64, 48).rgbd(*compiled(spec), "eye")
    ball = mujoco.mjtGeom.mjGEOM_SPHERE
    spec.worldbody.add_geom(type=ball, size=[0.3, 0, 0], group=3, rgba=RED)
    spec.worldbody.add_site(type=ball, size=[0.3, 0, 0], rgba=RED)
    hidden = Renderer(64, 48).rgbd(*compiled(spec), "eye")
    np.testing.assert_array_equal(hidden.rgb, plain.rgb)
    np.testing.assert_array_equal(hidden.depth_m, plain.depth_m)


def test_rendering_leaves_the_model_alone() -> None:
    model, data = compiled(table_scene())
    model.vis.quality.numslices, model.vis.global_.offwidth = 17, 123
    Renderer(64, 48).rgbd(model, data, "eye")
    assert (model.vis.quality.numslices, model.vis.global_.offwidth) == (17, 123)


@pytest.mark.parametrize("quality", ["video", "presentation"])
def test_pictures_for_people_have_shadows(quality: str) -> None:
    model, data = compiled(table_scene())
    # The light comes from -x and -y, so the shadow lies beside the cube.
    view = FreeCamera((0.1, 0.0, 0.0), 1.0, 135.0, -50.0)
    flat = Renderer(320, 240).rgb(model, data, view)
    picture = Renderer(320, 240, quality).rgb(model, data, view)
    assert picture.shape == flat.shape
    camera = view.camera(320, 240)
    ((u, v), (x, y)), _ = camera.project([[0.15, -0.04, 0.0], [0.0, 0.0, 0.0]])
    shaded, lit = (round(v), round(u)), (round(y), round(x))
    assert picture[shaded].sum() < 0.8 * flat[shaded].sum()
    assert picture[lit].sum() == pytest.approx(int(flat[lit].sum()), rel=0.1)


def test_oversampling_softens_edges() -> None:
    model, data = compiled(table_scene())
    cube = model.geom("cube").id
    hard, soft = (
        Renderer(320, 240, quality).rgb(model, data, OBLIQUE).astype(int)
        for quality in ("sensor", "presentation")
    )
    geoms = Renderer(320, 240).segmentation(model, data, OBLIQUE)
    rows, columns = np.nonzero((geoms[:-1] == cube) & (geoms[1:] != cube))
    steps = [np.abs(np.diff(p, axis=0))[rows, columns].sum() for p in (hard, soft)]
    assert steps[1] < 0.9 * steps[0]


def test_threads_take_turns() -> None:
    model, data = compiled(table_scene())
    renderer = Renderer(64, 48)
    expected = renderer.rgbd(model, data, "eye").rgb
    found: list[np.ndarray] = []

    def work() -> None:
        own = Renderer(64, 48)
        for _ in range(5):
            found.append(own.rgbd(model, data, "eye").rgb)
            found.append(renderer.rgb(model, data, "eye"))

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 30
    assert all(np.array_equal(rgb, expected) for rgb in found)


def test_a_closed_renderer_can_be_used_again() -> None:
    model, data = compiled(table_scene())
    renderer = Renderer(64, 48)
    before = renderer.rgb(model, data, "eye")
    renderer.close()
    renderer.close()
    np.testing.assert_array_equal(renderer.rgb(model, data, "eye"), before)


def test_what_cannot_be_rendered_is_explained() -> None:
    model, data = compiled(table_scene())
    with pytest.raises(UnknownNameError, match=r"Unknown camera 'eyes'.*Valid: eye"):
        Renderer().rgb(model, data, "eyes")
    with pytest.raises(UnknownNameError, match="Unknown quality 'sensors'"):
        Renderer(quality="sensors")
    with pytest.raises(InvalidConfigError, match="from 1 to 8192"):
        Renderer(0, 480)
    with pytest.raises(InvalidConfigError, match="quality='sensor'"):
        Renderer(64, 48, "presentation").rgbd(model, data, "eye")
