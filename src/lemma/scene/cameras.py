"""Calibrated cameras: poses, intrinsics, projection of points.

Camera frames follow OpenCV: x right, y down, z forward (MuJoCo's own have y up and z
backward). Pixel coordinates follow OpenCV as well: u grows to the right, v grows
downward, and the centre of the pixel in row r and column c is (u, v) = (c, r). An
image thus spans u from -0.5 to width - 0.5, and its centre is ((width - 1) / 2,
(height - 1) / 2). Depth is the distance along the camera's z axis, not along the ray.

This module does not need MuJoCo. Cameras of a compiled scene are in
:mod:`lemma.scene.rendering.model_cameras`.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray, Pose

RgbImage = NDArray[np.uint8]
DepthImage = NDArray[np.float32]

CLOSE_PX = 224
"""Default width and height of images at control level [px]."""


@dataclass(frozen=True, slots=True)
class CameraIntrinsics:
    """The pinhole model of a camera."""

    width: int
    """Image width [px]."""
    height: int
    """Image height [px]."""
    fx: float
    """Focal length along u [px]."""
    fy: float
    """Focal length along v [px]."""
    cx: float
    """Principal point, u [px]; the centre of the first column is 0."""
    cy: float
    """Principal point, v [px]; the centre of the first row is 0."""

    @classmethod
    def from_fovy(cls, fovy_rad: float, width: int, height: int) -> "CameraIntrinsics":
        """Return intrinsics with square pixels and a centred principal point.

        Args:
            fovy_rad: Vertical field of view [rad].
            width: Image width [px].
            height: Image height [px].

        Raises:
            InvalidConfigError: The size or the field of view is impossible.
        """
        if width < 1 or height < 1:
            raise InvalidConfigError(
                f"An image of {width} x {height} pixels cannot be rendered. Both "
                "sides must be at least 1."
            )
        if not 0.0 < fovy_rad < math.pi:
            raise InvalidConfigError(
                f"A field of view of {fovy_rad} rad is impossible. It must lie "
                "between 0 and pi; 1.0 is common."
            )
        focal = 0.5 * height / math.tan(0.5 * fovy_rad)
        return cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    @classmethod
    def from_shorter_side(
        cls, fov_rad: float, width: int, height: int
    ) -> "CameraIntrinsics":
        """Return intrinsics like :meth:`from_fovy`, but for the shorter side.

        The largest square in the middle of the image then has the same view at any
        aspect ratio.

        Args:
            fov_rad: Field of view of the shorter side [rad].
            width: Image width [px].
            height: Image height [px].

        Raises:
            InvalidConfigError: The size or the field of view is impossible.
        """
        longer = max(1.0, height / max(1, width))
        fovy_rad = 2.0 * math.atan(math.tan(0.5 * fov_rad) * longer)
        return cls.from_fovy(fovy_rad, width, height)

    @property
    def fovy_rad(self) -> float:
        """Vertical field of view [rad]."""
        return 2.0 * math.atan(0.5 * self.height / self.fy)

    def matrix(self) -> FloatArray:
        """Return the intrinsic matrix K, shape (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated camera."""

    name: str
    """Name in the scene."""
    world_from_camera: Pose
    """World from camera; x right, y down, z forward."""
    intrinsics: CameraIntrinsics
    """The pinhole model."""

    def project(self, points_world: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Project points to the image.

        Args:
            points_world: Points in the world frame [m], shape (N, 3).

        Returns:
            Pixels (u, v), shape (N, 2), and depths [m], shape (N,). The pixel of a
            point that is not in front of the camera (depth <= 0) is NaN.
        """
        points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        matrix = self.world_from_camera.matrix()
        in_camera = (points - matrix[:3, 3]) @ matrix[:3, :3]
        depth = in_camera[:, 2]
        scale = 1.0 / np.where(depth > 0.0, depth, np.nan)
        lens = self.intrinsics
        u = lens.fx * in_camera[:, 0] * scale + lens.cx
        v = lens.fy * in_camera[:, 1] * scale + lens.cy
        return np.stack([u, v], axis=1), depth

    def unproject(self, depth_m: ArrayLike) -> FloatArray:
        """Return the points of a depth image.

        Args:
            depth_m: Depth image [m], shape (height, width).

        Returns:
            Points in the world frame [m], shape (height, width, 3); NaN where the
            depth is 0 (no surface).

        Raises:
            InvalidConfigError: The image's size differs from the camera's.
        """
        depth = np.asarray(depth_m, dtype=np.float64)
        lens = self.intrinsics
        if depth.shape != (lens.height, lens.width):
            raise InvalidConfigError(
                f"The depth image has shape {depth.shape}, but camera {self.name!r} "
                f"makes images of shape {(lens.height, lens.width)} (rows, columns)."
            )
        depth = np.where(depth > 0.0, depth, np.nan)
        x = (np.arange(lens.width) - lens.cx) / lens.fx * depth
        y = ((np.arange(lens.height) - lens.cy) / lens.fy)[:, None] * depth
        matrix = self.world_from_camera.matrix()
        return np.stack([x, y, depth], axis=-1) @ matrix[:3, :3].T + matrix[:3, 3]


class CameraImage(NamedTuple):
    """Color and depth image of a camera."""

    rgb: RgbImage
    """Color, shape (height, width, 3)."""
    depth_m: DepthImage
    """Distance along the camera's z axis [m], shape (height, width); 0: no surface."""
    camera: Camera
    """The camera at the time of the image."""


@dataclass(frozen=True, slots=True)
class FreeCamera:
    """A camera for viewers that orbits a point; it is not part of the scene."""

    lookat: tuple[float, float, float] = (0.0, 0.0, 0.1)
    """The point at the centre of the image [m], world frame."""
    distance: float = 3.0
    """Distance from that point [m]."""
    azimuth_deg: float = 90.0
    """Azimuth of the viewing direction: 0 is along +x, 90 along +y [deg]."""
    elevation_deg: float = -35.0
    """Elevation of the viewing direction: negative is down [deg]."""
    fovy_deg: float = 40.0
    """Vertical field of view [deg]."""

    def camera(self, width: int, height: int) -> Camera:
        """Return the equivalent calibrated camera, for overlays on its images.

        Args:
            width: Image width [px].
            height: Image height [px].
        """
        azimuth, elevation = map(math.radians, (self.azimuth_deg, self.elevation_deg))
        ca, sa = math.cos(azimuth), math.sin(azimuth)
        ce, se = math.cos(elevation), math.sin(elevation)
        forward = np.array([ce * ca, ce * sa, se])
        right = np.array([sa, -ca, 0.0])
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        matrix[:3, 3] = np.array(self.lookat) - self.distance * forward
        lens = CameraIntrinsics.from_fovy(math.radians(self.fovy_deg), width, height)
        return Camera("free", Pose.from_matrix(matrix), lens)
