"""The cameras of a scene.

Each robot has a camera above it, named like the robot; top-down maps are fused from
these. Each robot also has a wrist camera, ``robot_0_wrist``, which looks between the
fingers, and ``robot_0_reach``, its overhead image cropped to its reach. Two further
cameras are fixed: the overview, from the side, and ``table``, from above.
"""

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import mujoco
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray, Pose
from lemma.env.view import View
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.ur.kinematics import frames
from lemma.scene.camera_mounts import (
    CAMERA_HEIGHT_PX,
    CAMERA_WIDTH_PX,
    REACH_EDGE_M,
    reach_mount,
)
from lemma.scene.cameras import (
    Camera,
    CameraImage,
    CameraIntrinsics,
    DepthImage,
    FreeCamera,
)
from lemma.scene.raster import LARGEST, RASTER, UNIT_M, MapImage
from lemma.scene.rendering.batch import BATCH_RENDERERS, Pictures
from lemma.scene.rendering.model_cameras import camera_from_model
from lemma.scene.scene import Scene
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.scene.topdown_map import fuse

OVERVIEW = FreeCamera(
    lookat=(0.0, -0.05, 0.1), distance=3.6, azimuth_deg=90.0, elevation_deg=-36.0
)
"""Camera that sees the whole table from the side."""
OVERVIEW_NAME = "overview"
TABLE_NAME = "table"
_ABOVE_M = 3.0
"""Height of the camera above the table's middle [m]; data sets store depths up to 4
m."""
TABLE_FOV_RAD = 2.0 * math.atan(
    (max(TABLE_HALF_X_M, TABLE_HALF_Y_M) + REACH_EDGE_M) / _ABOVE_M
)
"""Field of view of the shorter side of its images."""
TABLE_MOUNT = Pose.from_matrix(
    np.array(
        [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, -1.0, 0.0, 0.0],
            [0.0, 0.0, -1.0, _ABOVE_M],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
)
"""World from that camera: up in the image is +y, as in maps."""
WRIST_FOVY_RAD = math.radians(75.0)
WRIST_EYE_M = (0.09, 0.0, 0.05)
"""Position of a wrist camera in the frame of the flange, beside the palm [m]."""
_WRIST_TARGET_M = (0.0, 0.0, TCP_OFFSET_M + 0.02)

_PLAIN = tuple(field.name for field in fields(View) if field.name != "cameras")


def wrist_name(robot: str) -> str:
    """Return the name of a robot's wrist camera."""
    return f"{robot}_wrist"


def reach_name(robot: str) -> str:
    """Return the name of a robot's overhead camera cropped to its reach."""
    return f"{robot}_reach"


def camera_names(robots: Sequence[str]) -> tuple[str, ...]:
    """Return the names of all cameras of a team."""
    wrists, reaches = map(wrist_name, robots), map(reach_name, robots)
    return (*robots, OVERVIEW_NAME, *wrists, *reaches, TABLE_NAME)


def close_cameras(robots: Sequence[str]) -> tuple[str, ...]:
    """Return the default cameras of the control level.

    The first ones are close-ups, in which cubes are large. The last one shows the
    regions that no robot reaches without the stick, which the close-ups do not.
    """
    return (*map(reach_name, robots), *map(wrist_name, robots), TABLE_NAME)


def wrist_mount() -> Pose:
    """Return the pose of a wrist camera in the frame of the flange.

    The fingers open to the left and to the right of the image.
    """
    eye, target = np.array(WRIST_EYE_M), np.array(_WRIST_TARGET_M)
    forward = target - eye
    forward /= math.hypot(*forward.tolist())
    right = np.array([0.0, 1.0, 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = eye
    return Pose.from_matrix(matrix)


class CameraRig:
    """The cameras of a scene, of one image size.

    Reuse a rig: its renderer switches between scenes at little cost.
    """

    def __init__(
        self,
        width: int = CAMERA_WIDTH_PX,
        height: int = CAMERA_HEIGHT_PX,
        renderer: str = "opengl",
    ) -> None:
        """Prepare; OpenGL starts with the first image.

        Args:
            width: Width of camera images [px]. Maps are fused from these images, so
                evaluate policies at the size that they were trained with.
            height: Height of camera images [px].
            renderer: A name in :data:`lemma.scene.rendering.batch.BATCH_RENDERERS`.

        Raises:
            InvalidConfigError: The size is impossible.
            UnknownNameError: There is no such renderer.
            RenderingError: It is not installed.
        """
        self._renderer = BATCH_RENDERERS[renderer](width, height)
        self._size = (width, height)

    def look(
        self,
        scene: Scene,
        robots: Sequence[str] | None = None,
        cameras: Sequence[str] | None = None,
    ) -> View:
        """Return the present view.

        Images and map are rendered on first access. They show the state at the time of
        this call, even if the scene has changed since. The scene is not modified.

        Args:
            scene: The scene.
            robots: Names of the robots whose joints and cameras are of interest; all
                if None.
            cameras: Names of the cameras whose images are of interest, see
                :func:`camera_names`; those of the robots if None.
        """
        names = tuple(robots or scene.spec.robot_names)
        chosen = names if cameras is None else tuple(cameras)
        return _SceneView(self, scene, names, chosen)

    def capture(
        self,
        scene: Scene,
        *,
        cameras: bool = False,
        robots: Sequence[str] | None = None,
    ) -> View:
        """Return the present view, already rendered: plain data without the scene.

        Args:
            scene: The scene.
            robots: Names of the robots whose joints and cameras are of interest; all
                if None.
            cameras: Whether to include the camera images beside the map.
        """
        seen = self.look(scene, robots)
        # Read these first, or they are rendered twice.
        images = seen.cameras if cameras else {}
        return replace(View(*(getattr(seen, name) for name in _PLAIN)), cameras=images)

    def photograph(
        self, scene: Scene, qpos: FloatArray, cameras: Sequence[str]
    ) -> dict[str, CameraImage]:
        """Render some cameras, with depths as they are stored.

        Args:
            scene: The scene.
            qpos: The positions of all its joints, (nq,).
            cameras: Their names, see :func:`camera_names`.

        Raises:
            RenderingError: OpenGL does not work here.
        """
        pictures = self.film(scene, qpos[None], cameras)
        assert pictures.depth_m is not None
        data = scene.posed(qpos)
        return {
            name: CameraImage(rgb, depth_m, self.calibrated(scene, data, name))
            for name, rgb, depth_m in zip(
                cameras, pictures.rgb[0], pictures.depth_m[0], strict=True
            )
        }

    def film(
        self,
        scene: Scene,
        qpos: FloatArray,
        cameras: Sequence[str],
        *,
        depth: bool = True,
    ) -> Pictures:
        """Render some cameras in many states, with depths as they are stored.

        Args:
            scene: The scene; its own state is left alone.
            qpos: The positions of all its joints in each state, (states, nq).
            cameras: Names of the cameras, see :func:`camera_names`.
            depth: Whether to render depth too.

        Raises:
            RenderingError: The renderer does not work here.
        """

        def aim(data: mujoco.MjData) -> list[str | Camera]:
            return [
                f"{name}/camera"
                if name in scene.spec.robot_names
                else self.calibrated(scene, data, name)
                for name in cameras
            ]

        pictures = self._renderer.render(scene, qpos, aim, depth=depth)
        if pictures.depth_m is not None:
            for image in pictures.depth_m.reshape(-1, *pictures.depth_m.shape[-2:]):
                round_depth(image)
        return pictures

    def describe(self) -> str:
        """Return the name of the renderer and of its device."""
        return self._renderer.describe()

    def calibrated(self, scene: Scene, data: mujoco.MjData, name: str) -> Camera:
        """Return a camera with its intrinsics and extrinsics.

        Args:
            scene: The scene.
            data: A state of it, with derived poses up to date.
            name: See :func:`camera_names`.
        """
        if name in scene.spec.robot_names:
            return camera_from_model(scene.model, data, f"{name}/camera", *self._size)
        if name == OVERVIEW_NAME:
            return replace(OVERVIEW.camera(*self._size), name=name)
        if name == TABLE_NAME:
            lens = CameraIntrinsics.from_shorter_side(TABLE_FOV_RAD, *self._size)
            return Camera(name, TABLE_MOUNT, lens)
        for robot_name, placement in zip(
            scene.spec.robot_names, scene.spec.robots, strict=True
        ):
            if name == reach_name(robot_name):
                mount, fov = reach_mount(placement)
                lens = CameraIntrinsics.from_shorter_side(fov, *self._size)
                return Camera(name, mount, lens)
        robot = next(r for r in scene.robots if wrist_name(r.name) == name)
        placed = np.empty((7, 4, 4))
        frames(robot.arm.dh, robot.world_from_base, data.qpos[robot.qpos], placed)
        lens = CameraIntrinsics.from_fovy(WRIST_FOVY_RAD, *self._size)
        return Camera(name, Pose.from_matrix(placed[6] @ wrist_mount().matrix()), lens)

    def close(self) -> None:
        """Release the last scene; the rig can still be used afterwards."""
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
    """A view whose images are rendered on first access."""

    _rig: CameraRig
    _scene: Scene
    _robots: tuple[str, ...]
    _cameras: tuple[str, ...]
    _qpos: FloatArray

    def __init__(
        self,
        rig: CameraRig,
        scene: Scene,
        robots: tuple[str, ...],
        cameras: tuple[str, ...],
    ) -> None:
        data, found = scene.data, [scene.robot(name) for name in robots]
        # The base class is a frozen dataclass, so assign through ``vars``.
        vars(self).update(
            joints=np.array([data.qpos[robot.qpos] for robot in found]),
            opening_m=np.array([scene.opening_m(robot) for robot in found]),
            joint_velocities=np.array([data.qvel[robot.dof] for robot in found]),
            opening_m_s=np.array([scene.opening_m_s(robot) for robot in found]),
            _rig=rig,
            _scene=scene,
            _robots=robots,
            _cameras=cameras,
            _qpos=data.qpos.copy(),
        )

    @cached_property
    def cameras(self) -> dict[str, CameraImage]:
        return self._photograph(self._cameras)

    @cached_property
    def _map(self) -> MapImage:
        # Keep only the images that were read: the others are four times as large.
        seen: dict[str, CameraImage] = vars(self).get("cameras", {})
        if not set(self._robots) <= set(seen):
            seen = self._photograph(self._robots)
        fused = fuse([seen[name] for name in self._robots])
        stored = RASTER.encode_height(fused.height_m, fused.coverage)
        return MapImage(fused.rgb, RASTER.decode_height(stored), fused.coverage)

    def _photograph(self, cameras: tuple[str, ...]) -> dict[str, CameraImage]:
        return self._rig.photograph(self._scene, self._qpos, cameras)

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
        """Pickle as plain data, with all images rendered."""
        return View, tuple(getattr(self, field.name) for field in fields(View))
