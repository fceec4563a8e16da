"""The robots' cameras: what makes views of a scene, for whoever needs them."""

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.env.view import View
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.scene.cameras import CameraImage, DepthImage
from lemma.scene.raster import LARGEST, RASTER, UNIT_M, MapImage
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.scene.topdown_map import fuse

_PLAIN = tuple(field.name for field in fields(View) if field.name != "cameras")


class CameraRig:
    """One camera per robot, of one image size.

    Keep it: its renderer changes from scene to scene at little cost.
    """

    def __init__(
        self, width: int = CAMERA_WIDTH_PX, height: int = CAMERA_HEIGHT_PX
    ) -> None:
        """Prepare; OpenGL is started by the first picture.

        Args:
            width: Width of camera images [px]. Maps are fused from them, so policies
                should see with the size that they were trained with.
            height: Height of camera images [px].

        Raises:
            InvalidConfigError: The size is impossible.
        """
        self._renderer = Renderer(width, height)

    def look(self, scene: Scene, robots: Sequence[str] | None = None) -> View:
        """Return what is seen now.

        Images and map are rendered when they are first asked for, and show this moment
        whatever happens to the scene in between. The scene is left alone.

        Args:
            scene: What to look at.
            robots: Names of the robots whose joints and cameras are of interest; all
                if None.
        """
        return _SceneView(self, scene, tuple(robots or scene.spec.robot_names))

    def capture(self, scene: Scene, *, cameras: bool = False) -> View:
        """Return what is seen now, rendered now: plain data, which knows no scene.

        Args:
            scene: What to look at.
            cameras: Whether the images of the cameras are kept beside the map.
        """
        seen = self.look(scene)
        # First of all, or they are rendered twice.
        images = seen.cameras if cameras else {}
        return replace(View(*(getattr(seen, name) for name in _PLAIN)), cameras=images)

    def photograph(
        self, scene: Scene, qpos: FloatArray, robots: Sequence[str]
    ) -> dict[str, CameraImage]:
        """Render the cameras of some robots, with depths as they are stored.

        Args:
            scene: The scene.
            qpos: The positions of all its joints, (nq,).
            robots: Names of the robots.

        Raises:
            RenderingError: OpenGL does not work here.
        """
        data = scene.posed(qpos)
        found = {}
        for name in robots:
            image = self._renderer.rgbd(scene.model, data, f"{name}/camera")
            round_depth(image.depth_m)
            found[name] = image
        return found

    def close(self) -> None:
        """Forget the last scene; the rig can still be used afterwards."""
        self._renderer.close()


@kernel
def round_depth(depth_m: DepthImage) -> None:
    """Encode depths [m] and decode them again, in place: see the raster's module."""
    for row in depth_m:
        for j in range(row.shape[0]):
            value = np.rint(np.float64(row[j]) / UNIT_M)
            stored = value if value <= LARGEST else 0.0
            row[j] = np.float32(stored) * np.float32(UNIT_M)


class _SceneView(View):
    """A view whose pictures are rendered when they are asked for."""

    _rig: CameraRig
    _scene: Scene
    _robots: tuple[str, ...]
    _qpos: FloatArray

    def __init__(self, rig: CameraRig, scene: Scene, robots: tuple[str, ...]) -> None:
        data, found = scene.data, [scene.robot(name) for name in robots]
        # The base class is frozen, and this one not done yet.
        vars(self).update(
            joints=np.array([data.qpos[robot.qpos] for robot in found]),
            opening_m=np.array([scene.opening_m(robot) for robot in found]),
            joint_velocities=np.array([data.qvel[robot.dof] for robot in found]),
            opening_m_s=np.array([scene.opening_m_s(robot) for robot in found]),
            _rig=rig,
            _scene=scene,
            _robots=robots,
            _qpos=data.qpos.copy(),
        )

    @cached_property
    def cameras(self) -> dict[str, CameraImage]:
        return self._photograph()

    @cached_property
    def _map(self) -> MapImage:
        # Images that nobody asked for are not kept: they are four times as large.
        images = vars(self).get("cameras") or self._photograph()
        fused = fuse(images.values())
        stored = RASTER.encode_height(fused.height_m, fused.coverage)
        return MapImage(fused.rgb, RASTER.decode_height(stored), fused.coverage)

    def _photograph(self) -> dict[str, CameraImage]:
        return self._rig.photograph(self._scene, self._qpos, self._robots)

    @property
    def rgb(self) -> NDArray[np.uint8]:
        return self._map.rgb

    @property
    def height_m(self) -> NDArray[np.float32]:
        return self._map.height_m

    @property
    def coverage(self) -> NDArray[np.bool_]:
        return self._map.coverage

    def __reduce__(self) -> tuple[type[View], tuple[Any, ...]]:
        """Return how it is pickled: as plain data, with all pictures."""
        return View, tuple(getattr(self, field.name) for field in fields(View))
