"""Renderers of color and depth images of many states of a scene, by name.

``opengl`` draws one image after the other, as environments do. ``warp`` traces the rays
of hundreds of states at once on an NVIDIA GPU, with MuJoCo Warp. Their images agree to
within one step of 8-bit color and 1 um of depth, except in pixels that contain an edge.

The first ray tracer imports the optional packages ``mujoco-warp`` and ``warp-lang``.
They also run on a CPU, slower than OpenGL, for tests. MuJoCo computes the poses in
double precision; the GPU gets the poses of geoms, cameras and lights and traces one ray
per pixel. So only the ray tracer of MuJoCo Warp is compiled, once per machine and set
of geom types.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError, RenderingError
from lemma.core.poses import FloatArray, matrix_from_quaternion
from lemma.core.registry import Registry
from lemma.scene.cameras import Camera
from lemma.scene.rendering.gl_backend import choose_backend
from lemma.scene.rendering.gl_context import current_context
from lemma.scene.rendering.model_cameras import camera_from_model
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene

AUTO = "auto"
"""Name for the fastest available renderer."""
_MOST_STATES = 64
_MOST_PIXELS = 2**22
VISIBLE_GROUPS = [0, 1, 2]
"""Geom groups that are drawn."""
_KEPT_CONTEXTS = 4
"""Contexts kept on the GPU, each with meshes and trees for scenes of equal shapes."""
_LARGEST_PX = 8192
# Arrays of a model that are part of a context; others are passed with each launch.
_SHAPES = (
    *("geom_type", "geom_group", "light_type", "light_attenuation"),
    *("mesh_vert", "mesh_face", "mesh_faceadr", "mesh_vertadr"),
    *("mesh_normal", "mesh_facenormal"),
)

Aim = Callable[[mujoco.MjData], Sequence[str | Camera]]
"""Returns the cameras for a state with up-to-date derived poses: names in the scene, or
calibrated cameras, which may differ between states."""


class Pictures(NamedTuple):
    """Images of several cameras in several states."""

    rgb: NDArray[np.uint8]
    """Color, shape (states, cameras, height, width, 3)."""
    depth_m: NDArray[np.float32] | None
    """Distance along the camera's z axis [m], shape (states, cameras, height, width);
    0: no surface. None if depth was not rendered."""


def states_at_once(width: int, height: int, cameras: int) -> int:
    """Return the number of states to render together, bounded by memory.

    Args:
        width: Width of every image [px].
        height: Height of every image [px].
        cameras: Number of cameras.

    Raises:
        InvalidConfigError: An argument is below 1.
    """
    if min(width, height, cameras) < 1:
        raise InvalidConfigError(
            f"{cameras} cameras of {width} x {height} pixels cannot be rendered. All "
            "three must be at least 1."
        )
    return max(1, min(_MOST_STATES, _MOST_PIXELS // (width * height * cameras)))


class OpenGLRenderer:
    """Draws image after image, on a GPU if EGL finds one, else in software.

    Create one per process and reuse it.
    """

    def __init__(self, width: int, height: int) -> None:
        """Set the size of images [px]; the first image starts OpenGL.

        Raises:
            InvalidConfigError: The size is impossible.
        """
        self._renderer = Renderer(width, height)

    def render(
        self, scene: Scene, qpos: FloatArray, aim: Aim, *, depth: bool
    ) -> Pictures:
        """Render states.

        Args:
            scene: The scene; its own state does not change.
            qpos: Positions of all joints in each state, shape (states, nq).
            aim: Returns the cameras of a state, equally many for every state.
            depth: Whether to render depth too.

        Raises:
            UnknownNameError: The scene has no such camera.
            RenderingError: OpenGL does not work here.
        """
        draw, model = self._renderer, scene.model
        colors, depths = np.empty(0, np.uint8), np.empty(0, np.float32)
        for i, row in enumerate(qpos):
            cameras = aim(data := scene.posed(row))
            if i == 0:
                size = (len(qpos), len(cameras), draw.height, draw.width)
                colors = np.empty((*size, 3), np.uint8)
                depths = np.empty(size if depth else 0, np.float32)
            # One block for the images of a state: its start and end take a while.
            with current_context():
                for k, camera in enumerate(cameras):
                    if depth:
                        draw.write_rgbd(model, data, camera, colors[i, k], depths[i, k])
                    else:
                        colors[i, k] = draw.rgb(model, data, camera)
        return Pictures(colors, depths if depth else None)

    def describe(self) -> str:
        """Return software and device, on both of which the pixels depend."""
        return choose_backend().renderer

    def close(self) -> None:
        """Free the last scene; the renderer can still be used afterwards."""
        self._renderer.close()


@cache
def _packages() -> tuple[ModuleType, ModuleType]:
    """Return warp and mujoco_warp.

    Raises:
        RenderingError: One is not installed.
    """
    try:
        import warp  # noqa: PLC0415

        # By default every worker logs devices and everything that it compiles.
        warp.config.log_level = warp.LOG_WARNING
        import mujoco_warp  # noqa: PLC0415
    except ImportError as error:
        raise RenderingError(
            "The renderer 'warp' needs MuJoCo Warp, which is not installed: pip "
            "install 'lemma-bench[warp]', or '.[warp]' in a checkout. The renderer "
            "'opengl' needs nothing more."
        ) from error
    warp.init()
    return warp, mujoco_warp


def has_gpu() -> bool:
    """Return whether MuJoCo Warp is installed and finds a GPU."""
    if find_spec("mujoco_warp") is None:
        return False
    return bool(_packages()[0].is_cuda_available())


@dataclass(slots=True)
class Poses:
    """Poses in each state: the part of MuJoCo Warp's data that a launch reads."""

    nworld: int
    geom_xpos: Any
    geom_xmat: Any
    cam_xpos: Any
    cam_xmat: Any
    light_xpos: Any
    light_xdir: Any
    flexvert_xpos: Any


class RayTracer:
    """Renders many states at once on a GPU, as :class:`OpenGLRenderer` does singly."""

    def __init__(self, width: int, height: int) -> None:
        """Set the size of images.

        Args:
            width: Width of every image [px].
            height: Height of every image [px].

        Raises:
            InvalidConfigError: The size is impossible.
            RenderingError: MuJoCo Warp is not installed.
        """
        if not (1 <= width <= _LARGEST_PX and 1 <= height <= _LARGEST_PX):
            raise InvalidConfigError(
                f"A picture of {width} x {height} pixels cannot be rendered. Both "
                f"sides must be from 1 to {_LARGEST_PX}."
            )
        _packages()
        self._size = (width, height)
        self._contexts: OrderedDict[tuple[object, ...], Any] = OrderedDict()
        self._scene: Scene | None = None
        self._model: Any = None
        self._shapes = ""

    def render(
        self, scene: Scene, qpos: FloatArray, aim: Aim, *, depth: bool
    ) -> Pictures:
        """Render states; see :meth:`OpenGLRenderer.render`.

        Raises:
            UnknownNameError: The scene has no such camera.
            RenderingError: The device failed.
        """
        self._take(scene)
        places, cameras = [], []
        for row in qpos:
            data = scene.posed(row)
            seen = [
                camera_from_model(scene.model, data, camera, *self._size)
                if isinstance(camera, str)
                else camera
                for camera in aim(data)
            ]
            places.append(_places(data))
            cameras.append([_camera_row(camera) for camera in seen])
        rows = np.array(cameras)
        together = states_at_once(*self._size, rows.shape[1])
        try:
            parts = [
                self._trace(
                    places[i : i + together], rows[i : i + together], depth=depth
                )
                for i in range(0, len(qpos), together)
            ]
        except RuntimeError as error:
            raise RenderingError(
                f"{self.describe()} could not render: {error} If there is too little "
                "memory, use fewer worker processes, which share it; the renderer "
                "'opengl' works without."
            ) from error
        rgb = np.concatenate([part.rgb for part in parts])
        depths = [part.depth_m for part in parts if part.depth_m is not None]
        return Pictures(rgb, np.concatenate(depths) if depth else None)

    def describe(self) -> str:
        """Return software version and device, on both of which the pixels depend."""
        warp, _ = _packages()
        return f"MuJoCo Warp {version('mujoco-warp')}, {warp.get_device().name}"

    def close(self) -> None:
        """Free all memory on the device; the renderer can still be used afterwards."""
        self._contexts.clear()
        self._scene = self._model = None

    def _take(self, scene: Scene) -> None:
        """Copy a new scene's colors, sizes and lights to the device."""
        if self._scene is scene:
            return
        model = scene.model
        digest = hashlib.sha256()
        for name in _SHAPES:
            digest.update(np.ascontiguousarray(getattr(model, name)).tobytes())
        view, lamp = model.vis.map, model.vis.headlight
        for value in (
            *(view.znear, view.zfar, model.stat.extent, lamp.active),
            *(*lamp.ambient, *lamp.diffuse, *lamp.specular),
        ):
            digest.update(np.float64(value).tobytes())
        self._shapes = digest.hexdigest()
        self._model = _packages()[1].put_model(model)
        self._scene = scene

    def _trace(
        self, places: list[tuple[FloatArray, ...]], rows: FloatArray, *, depth: bool
    ) -> Pictures:
        """Render states that fit into one launch."""
        warp, tracer = _packages()
        states, cameras = rows.shape[:2]
        context = self._context(cameras, depth=depth)
        geoms, turns, lamps, beams = (
            np.array(part) for part in zip(*places, strict=True)
        )

        def put(array: FloatArray, kind: Any) -> Any:
            return warp.array(np.ascontiguousarray(array, np.float32), dtype=kind)

        poses = Poses(
            nworld=states,
            geom_xpos=put(geoms, warp.vec3),
            geom_xmat=put(turns.reshape(*turns.shape[:2], 3, 3), warp.mat33),
            cam_xpos=put(rows[..., :3], warp.vec3),
            cam_xmat=put(rows[..., 3:12].reshape(states, cameras, 3, 3), warp.mat33),
            light_xpos=put(lamps, warp.vec3),
            light_xdir=put(beams, warp.vec3),
            flexvert_xpos=warp.empty((states, 0), dtype=warp.vec3),
        )
        model = replace(
            self._model,
            cam_projection=warp.zeros(cameras, dtype=int),
            cam_fovy=put(rows[..., 12], float),
            cam_sensorsize=warp.zeros(cameras, dtype=warp.vec2),
            cam_intrinsic=warp.zeros((1, cameras), dtype=warp.vec4),
        )
        tracer.refit_bvh(model, poses, context)
        tracer.render(model, poses, context)
        width, height = self._size
        packed = context.rgb_data[:states].numpy()
        channels = packed.view(np.uint8).reshape(states, cameras, height, width, 4)
        # The byte order is blue, green, red, opacity.
        rgb = np.ascontiguousarray(channels[..., 2::-1])
        if not depth:
            return Pictures(rgb, None)
        depth_m = context.depth_data[:states].numpy()
        return Pictures(rgb, depth_m.reshape(states, cameras, height, width).copy())

    def _context(self, cameras: int, *, depth: bool) -> Any:
        """Return buffers and trees for scenes of these shapes.

        They have room for as many states as fit into one launch; fewer cost no more.
        """
        warp, tracer = _packages()
        key = (self._shapes, cameras, depth)
        context = self._contexts.pop(key, None)
        if context is None:
            assert self._scene is not None
            context = tracer.create_render_context(
                self._scene.model,
                nworld=states_at_once(*self._size, cameras),
                cam_res=[self._size] * cameras,
                # Any camera is valid: every launch passes its own poses and lenses.
                cam_active=[0] * cameras,
                render_rgb=[True] * cameras,
                render_depth=[depth] * cameras,
                render_seg=[False] * cameras,
                use_textures=False,
                use_precomputed_rays=False,
                enabled_geom_groups=VISIBLE_GROUPS,
            )
            context.cam_id_map = warp.array(np.arange(cameras), dtype=int)
        self._contexts[key] = context
        if len(self._contexts) > _KEPT_CONTEXTS:
            self._contexts.popitem(last=False)
        return context


def _places(data: mujoco.MjData) -> tuple[FloatArray, ...]:
    """Return poses of geoms, and positions and directions of lights."""
    return (
        data.geom_xpos.copy(),
        data.geom_xmat.copy(),
        data.light_xpos.copy(),
        data.light_xdir.copy(),
    )


def _camera_row(camera: Camera) -> FloatArray:
    """Return position, rotation (as MuJoCo's: y up, z backward) and field of view.

    Returns:
        Shape (13,): position [m], rows of the rotation, vertical field of view [deg].
    """
    pose = camera.world_from_camera
    rotation = matrix_from_quaternion(pose.quaternion) * np.array([1.0, -1.0, -1.0])
    fovy_deg = np.degrees(camera.intrinsics.fovy_rad)
    return np.array([*pose.position, *rotation.ravel(), fovy_deg])


MakeRenderer = Callable[[int, int], OpenGLRenderer | RayTracer]

BATCH_RENDERERS: Registry[MakeRenderer] = Registry("renderer", MakeRenderer)
"""Constructors of renderers by name; arguments are the width and height of images [px].
"""
BATCH_RENDERERS.add("opengl", OpenGLRenderer)
BATCH_RENDERERS.add("warp", RayTracer)


def choose_renderer(name: str) -> str:
    """Return the name of an available renderer.

    Args:
        name: A name in :data:`BATCH_RENDERERS`, or ``"auto"``: ``warp`` if it is
            installed and finds a GPU, else ``opengl``.

    Raises:
        UnknownNameError: There is no such renderer.
        RenderingError: It is not installed.
    """
    if name == AUTO:
        return "warp" if has_gpu() else "opengl"
    # Report a missing package before any worker starts.
    BATCH_RENDERERS[name](1, 1)
    return name
