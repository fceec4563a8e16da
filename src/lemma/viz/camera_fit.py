"""The nearest camera that has all points in its picture."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from lemma.core.poses import FloatArray
from lemma.scene.cameras import FreeCamera
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene

NEAREST_M = 0.2
"""Least distance of a point in front of the camera; by its slopes alone the camera may
stand in the nearest point."""
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def views(
    scene: Scene, states: Sequence[FloatArray], size: tuple[int, int], quality: str
) -> list[Image.Image]:
    """Draw states from one viewpoint that shows all of them.

    Args:
        scene: The scene; it is left in the last state.
        states: States from :meth:`Scene.snapshot`.
        size: Width and height of each picture [px].
        quality: A name in :data:`lemma.scene.rendering.renderer.QUALITIES`.
    """
    points, pictures = [], []
    for state in states:
        scene.restore(state)
        points.append(outline(scene))
    camera = overview(np.concatenate(points), size[0] / size[1])
    renderer = Renderer(*size, quality)
    for state in states:
        scene.restore(state)
        pictures.append(Image.fromarray(renderer.rgb(scene.model, scene.data, camera)))
    return pictures


def overview(
    points: ArrayLike,
    aspect: float,
    *,
    azimuth_deg: float = 82.0,
    elevation_deg: float = -34.0,
    margin: float = 0.04,
) -> FreeCamera:
    """Return the nearest camera from a given side that has all points in its picture.

    In the camera's axes a point (r, d, f) is inside the picture of a camera at
    (R, D, F) if |r - R| <= a (f - F) and |d - D| <= b (f - F), with the slopes a and b
    of the picture's edges. This is linear, so the largest F has a closed form. Besides,
    all points are at least :data:`NEAREST_M` in front of it.

    Args:
        points: World positions, shape (N, 3) [m], such as :func:`outline` returns.
        aspect: Width of the picture divided by its height.
        azimuth_deg: Direction of view; 90 has the first robot on the left.
        elevation_deg: Direction of view against the horizontal.
        margin: Share of the picture left free on each side.
    """
    direction = FreeCamera(
        azimuth_deg=azimuth_deg, elevation_deg=elevation_deg, fovy_deg=30.0
    )
    axes = direction.camera(100, 100).world_from_camera.matrix()[:3, :3]
    right, down, forward = (np.asarray(points, dtype=np.float64) @ axes).T
    slope = math.tan(math.radians(direction.fovy_deg) / 2) * (1.0 - 2.0 * margin)
    position = np.empty(3)
    depths = []
    for axis, (across, edge) in enumerate(((right, slope * aspect), (down, slope))):
        high = float(np.max(across - edge * forward))
        low = float(np.max(-across - edge * forward))
        position[axis] = (high - low) / 2
        depths.append(-(high + low) / (2 * edge))
    position[2] = min(*depths, float(np.min(forward)) - NEAREST_M)
    distance = float(np.mean(forward) - position[2])
    x, y, z = (axes @ (position + np.array([0.0, 0.0, distance]))).tolist()
    return replace(direction, lookat=(x, y, z), distance=distance)


def outline(scene: Scene) -> FloatArray:
    """Return the corners of the boxes around all robots and objects, (N, 3) [m].

    Args:
        scene: The scene, with derived poses up to date (``refresh``).
    """
    model, data = scene.model, scene.data
    ours = np.flatnonzero(model.geom_bodyid > 0)
    middle, half = model.geom_aabb[ours, None, :3], model.geom_aabb[ours, None, 3:]
    corners = middle + half * _CORNERS
    rotations = data.geom_xmat[ours].reshape(-1, 3, 3)
    placed: FloatArray = np.einsum("gij,gcj->gci", rotations, corners)
    placed += data.geom_xpos[ours, None]
    return placed.reshape(-1, 3)
