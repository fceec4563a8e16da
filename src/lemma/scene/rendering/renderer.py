"""Renders scenes: fast color and depth images for robots, fine images for viewers."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.scene.cameras import Camera, CameraImage, DepthImage, FreeCamera, RgbImage
from lemma.scene.rendering.gl_context import (
    Tessellation,
    Upload,
    current_context,
    upload,
)
from lemma.scene.rendering.model_cameras import camera_from_model, camera_index

Scalar = TypeVar("Scalar", bound=np.generic)

_NEAR_M = 0.02
"""Near plane of calibrated cameras; small, because fingers are near wrist cameras."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Settings of image quality."""

    tessellation: Tessellation
    """Resolution of primitives and of the shadow map."""
    oversampling: int = 1
    """Samples along each side of a pixel, which are averaged."""
    scenery: bool = False
    """Whether to draw sky, haze and reflections."""


QUALITIES: Registry[Quality] = Registry("quality", Quality)
QUALITIES.add("sensor", Quality(Tessellation(slices=24, stacks=10, quads=2)))
QUALITIES.add(
    "video",
    Quality(
        Tessellation(slices=32, stacks=12, quads=8, shadow_map_px=2048),
        oversampling=2,
        scenery=True,
    ),
)
QUALITIES.add(
    "presentation",
    Quality(
        Tessellation(slices=64, stacks=24, quads=16, shadow_map_px=4096),
        oversampling=3,
        scenery=True,
    ),
)


class Renderer:
    """Renders any number of scenes off screen, one after the other.

    Create one and reuse it: the switch to another compiled scene is fast if its meshes
    and textures are the same.
    """

    def __init__(
        self, width: int = 640, height: int = 480, quality: str = "sensor"
    ) -> None:
        """Set size and quality of images; the first image starts OpenGL.

        Args:
            width: Width of every image [px].
            height: Height of every image [px].
            quality: A name in :data:`QUALITIES`: ``sensor`` is fast, with hard edges
                and without shadows; ``video`` has shadows and soft edges, at about
                8 times the cost; ``presentation`` is for print, at 30 times the cost.

        Raises:
            InvalidConfigError: The size is impossible.
            UnknownNameError: No such quality.
        """
        self.quality = QUALITIES[quality]
        limit = 8192 // self.quality.oversampling
        if not (1 <= width <= limit and 1 <= height <= limit):
            raise InvalidConfigError(
                f"A picture of {width} x {height} pixels cannot be rendered. Both "
                f"sides must be from 1 to {limit} with quality {quality!r}."
            )
        self.width = width
        self.height = height
        self._model: mujoco.MjModel | None = None
        self._scene: mujoco.MjvScene | None = None
        self._upload: Upload | None = None
        self._view = mujoco.MjvCamera()
        self._options = _visible()

    def rgbd(
        self, model: mujoco.MjModel, data: mujoco.MjData, camera: str | Camera
    ) -> CameraImage:
        """Render color and depth of a camera, in one pass.

        Transparent geoms (alpha below 1) have color but no depth.

        Args:
            model: The scene.
            data: Its state, with up-to-date derived poses (``mj_forward``).
            camera: Its name in the scene, or a calibrated camera of this size, whose
                near plane is at 2 cm.

        Raises:
            UnknownNameError: The scene has no such camera.
            InvalidConfigError: The quality has oversampling, or the camera has another
                image size.
            RenderingError: OpenGL does not work here.
        """
        if self.quality.oversampling != 1:
            raise InvalidConfigError(
                "Depth cannot be rendered with oversampling: the mean of two depths "
                "is not the depth of a surface. Use Renderer(quality='sensor')."
            )
        size = (self.width, self.height)
        calibrated = (
            camera_from_model(model, data, camera, *size)
            if isinstance(camera, str)
            else camera
        )
        rgb = np.empty((self.height, self.width, 3), np.uint8)
        buffer = np.empty((self.height, self.width), np.float32)
        scene = self._draw(model, data, camera, rgb, buffer)
        gl_camera = scene.camera[0]
        depth_m = depth_from_buffer(
            buffer, gl_camera.frustum_near, gl_camera.frustum_far
        )
        return CameraImage(_upright(rgb), _upright(depth_m), calibrated)

    def rgb(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        view: str | Camera | FreeCamera,
    ) -> RgbImage:
        """Render color only, shape (height, width, 3).

        Args:
            model: The scene.
            data: Its state, with up-to-date derived poses (``mj_forward``).
            view: A camera's name in the scene, a calibrated camera of this size, or a
                free camera.

        Raises:
            UnknownNameError: The scene has no such camera.
            InvalidConfigError: The camera has another image size.
            RenderingError: OpenGL does not work here.
        """
        factor = self.quality.oversampling
        pixels = np.empty((self.height * factor, self.width * factor, 3), np.uint8)
        self._draw(model, data, view, pixels, None)
        if factor > 1:
            pixels = np.asarray(Image.fromarray(pixels).reduce(factor))
        return _upright(pixels)

    def segmentation(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        view: str | Camera | FreeCamera,
    ) -> NDArray[np.int32]:
        """Render the index of the geom in each pixel, shape (height, width); -1: none.

        ``model.geom_bodyid`` has the body of each geom.

        Args:
            model: The scene.
            data: Its state, with up-to-date derived poses (``mj_forward``).
            view: A camera's name in the scene, a calibrated camera of this size, or a
                free camera.

        Raises:
            UnknownNameError: The scene has no such camera.
            InvalidConfigError: The camera has another image size.
            RenderingError: OpenGL does not work here.
        """
        factor = self.quality.oversampling
        pixels = np.empty((self.height * factor, self.width * factor, 3), np.uint8)
        scene = self._draw(model, data, view, pixels, None, segment=True)
        middle = pixels[factor // 2 :: factor, factor // 2 :: factor].astype(np.int32)
        number = middle[..., 0] + (middle[..., 1] << 8) + (middle[..., 2] << 16)
        # Number 0 is the background, number i + 1 the scene's geom with segid i.
        geom_of = np.full(scene.ngeom + 1, -1, np.int32)
        for drawn in scene.geoms[: scene.ngeom]:
            if drawn.segid >= 0 and drawn.objtype == mujoco.mjtObj.mjOBJ_GEOM.value:
                geom_of[drawn.segid + 1] = drawn.objid
        return _upright(geom_of[number])

    def close(self) -> None:
        """Free the last scene; the renderer can still be used afterwards."""
        self._model = self._scene = self._upload = None

    def _check_size(self, camera: Camera) -> None:
        """Check the image size of a camera.

        Raises:
            InvalidConfigError: It differs from that of this renderer.
        """
        lens = camera.intrinsics
        if (lens.width, lens.height) != (self.width, self.height):
            raise InvalidConfigError(
                f"Camera {camera.name!r} makes images of {lens.width} x {lens.height} "
                f"pixels, but this renderer makes {self.width} x {self.height}."
            )

    def _draw(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        view: str | Camera | FreeCamera,
        rgb: RgbImage,
        depth: DepthImage | None,
        *,
        segment: bool = False,
    ) -> mujoco.MjvScene:
        """Render into arrays whose first row is the bottom of the image."""
        fovy_deg = self._aim(model, view)
        height, width = rgb.shape[:2]
        with current_context():
            scene, drawing = self._prepare(model, width, height)
            flags = scene.flags
            flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = segment
            flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = segment
            mujoco.mjv_updateScene(
                model,
                data,
                self._options,
                None,
                self._view,
                mujoco.mjtCatBit.mjCAT_ALL.value,
                scene,
            )
            if fovy_deg is not None:
                for gl_camera in scene.camera:
                    half = gl_camera.frustum_near * np.tan(np.radians(fovy_deg) / 2)
                    gl_camera.frustum_bottom, gl_camera.frustum_top = -half, half
            if isinstance(view, Camera):
                _place(scene, view)
            area = mujoco.MjrRect(0, 0, width, height)
            # Uploads share one context, but each has its own buffer.
            mujoco.mjr_resizeOffscreen(width, height, drawing)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, drawing)
            mujoco.mjr_render(area, scene, drawing)
            mujoco.mjr_readPixels(rgb, depth, area, drawing)
        return scene

    def _aim(
        self, model: mujoco.MjModel, view: str | Camera | FreeCamera
    ) -> float | None:
        """Set MuJoCo's camera; return its field of view [deg], None for the scene's."""
        aim = self._view
        if isinstance(view, str):
            aim.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
            aim.fixedcamid = camera_index(model, view)
            return None
        aim.type = mujoco.mjtCamera.mjCAMERA_FREE.value
        if isinstance(view, Camera):
            self._check_size(view)
            return None
        aim.lookat[:] = view.lookat
        aim.distance = view.distance
        aim.azimuth, aim.elevation = view.azimuth_deg, view.elevation_deg
        return view.fovy_deg

    def _prepare(
        self, model: mujoco.MjModel, width: int, height: int
    ) -> tuple[mujoco.MjvScene, mujoco.MjrContext]:
        """Return scene and context to draw with; only inside ``current_context``."""
        if self._scene is None or self._model is not model:
            # Sites and decoration are hidden, so only geoms need memory.
            self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 16)
            flags = self._scene.flags
            flags[mujoco.mjtRndFlag.mjRND_SHADOW] = (
                self.quality.tessellation.shadow_map_px > 0
            )
            flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = self.quality.scenery
            flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = self.quality.scenery
            flags[mujoco.mjtRndFlag.mjRND_HAZE] = self.quality.scenery
            flags[mujoco.mjtRndFlag.mjRND_FOG] = False
            self._model = model
            self._upload = None
        if self._upload is None or self._upload.drawing is None:
            self._upload = upload(model, self.quality.tessellation, width, height)
        return self._scene, self._upload.drawing


def _place(scene: mujoco.MjvScene, camera: Camera) -> None:
    """Set a calibrated camera with square pixels and a centred principal point."""
    matrix = camera.world_from_camera.matrix()
    half = _NEAR_M * np.tan(0.5 * camera.intrinsics.fovy_rad)
    for gl_camera in scene.camera:
        gl_camera.pos[:] = matrix[:3, 3]
        gl_camera.forward[:], gl_camera.up[:] = matrix[:3, 2], -matrix[:3, 1]
        gl_camera.frustum_near = _NEAR_M
        gl_camera.frustum_bottom, gl_camera.frustum_top = -half, half
        gl_camera.frustum_center = 0.0


def depth_from_buffer(buffer: DepthImage, near_m: float, far_m: float) -> DepthImage:
    """Convert MuJoCo's depth buffer to distances along the view axis.

    MuJoCo draws with reversed depth (``setView`` in its ``render_gl3.c``): with
    ``readDepthMap = mjDEPTH_ZEROFAR`` a point at distance z reads

        d = (near / z) (far - z) / (far - near),

    which is 1 at the near plane and 0 at the far plane. This function solves it for z.

    Args:
        buffer: Depth as ``mjr_readPixels`` returns it.
        near_m: Near clipping plane [m].
        far_m: Far clipping plane [m].

    Returns:
        Depth [m], same shape; 0 where there is no surface.
    """
    depth = np.multiply(buffer, np.float32(far_m - near_m))
    depth += np.float32(near_m)
    np.divide(np.float32(far_m * near_m), depth, out=depth)
    depth[buffer == 0.0] = 0.0
    return depth


def _visible() -> mujoco.MjvOption:
    """Return options that show visual geoms (groups 0 to 2) only."""
    options = mujoco.MjvOption()
    for group in (
        *(options.sitegroup, options.jointgroup, options.tendongroup),
        *(options.actuatorgroup, options.skingroup),
    ):
        group[:] = 0
    options.geomgroup[:] = (1, 1, 1, 0, 0, 0)
    options.flags[mujoco.mjtVisFlag.mjVIS_RANGEFINDER] = False
    return options


def _upright(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return a copy whose first row is the top."""
    return np.ascontiguousarray(picture[::-1])
