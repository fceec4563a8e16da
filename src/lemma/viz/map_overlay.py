"""The top-down map with reach, names and goal."""

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lemma.core.poses import Pose2
from lemma.robots.could import could_of
from lemma.robots.reach import reach_map, reach_of
from lemma.scene.cameras import CameraImage
from lemma.scene.objects.entity import HAND, STICK, entity_named
from lemma.scene.objects.stick import HANDLE_LENGTH_M
from lemma.scene.raster import RASTER, MapImage
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.scene.topdown_map import fuse
from lemma.tasks.instance import Instance
from lemma.viz.annotate import (
    ENTITY_INK,
    INK,
    ROBOT_INK,
    Box,
    Canvas,
    Color,
    Point,
)
from lemma.viz.recording import robot_titles

_GOAL_INK: Color = (190, 40, 160)
_NOT_SEEN = (214, 216, 219)
_SHARED_TINT = np.array([255, 238, 170], dtype=np.float64)


def camera_images(scene: Scene, renderer: Renderer | None = None) -> list[CameraImage]:
    """Return the images of all robots' cameras, for :func:`annotated_map`.

    Args:
        scene: The scene.
        renderer: Draws them; a new one if None.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    renderer = renderer or Renderer()
    scene.refresh()
    return [
        renderer.rgbd(scene.model, scene.data, f"{name}/camera")
        for name in scene.spec.robot_names
    ]


def pixel_of(x: float, y: float, width: float) -> Point:
    """Return the point of a map of a width [px] for a position on the table [m]."""
    cell_px = width / RASTER.columns
    return (
        (RASTER.columns / 2 + x / RASTER.cell_m) * cell_px,
        (RASTER.rows / 2 - y / RASTER.cell_m) * cell_px,
    )


def annotated_map(
    instance: Instance, scene: Scene, images: list[CameraImage], width: int
) -> Image.Image:
    """Return the map of a scene with reach, names and goal drawn on it.

    A solid circle bounds the region in which a robot can surely work, a dashed one the
    region that it could touch at most.

    Args:
        instance: The instance of the scene.
        scene: The scene, in the state to draw.
        images: Images of its cameras, from :func:`camera_images`.
        width: Width of the picture [px]; its height follows.
    """
    scale = width / RASTER.columns
    shaded = Image.fromarray(_shade(fuse(images, RASTER), instance))
    canvas = Canvas(
        shaded.resize((width, round(RASTER.rows * scale)), Image.Resampling.BICUBIC)
    )
    size, metre = width / 62, scale / RASTER.cell_m
    for placed in instance.scene.robots:
        reach, could = reach_of(placed.arm), could_of(placed.arm)
        centre = pixel_of(placed.base.x, placed.base.y, width)
        # A dark edge makes white visible on pale ground.
        for ink, width_px in ((INK, 0.30), (ROBOT_INK[placed.color], 0.18)):
            thick = width_px * size
            canvas.circle(
                centre, could.touch_m * metre, ink, 0.7 * thick, dash=size / 2
            )
            canvas.circle(centre, reach.travel_m * metre, ink, thick)
            canvas.circle(centre, reach.inner_m * metre, ink, thick)
    _name_entities(canvas, instance, scene, width)
    return canvas.picture()


def _shade(fused: MapImage, instance: Instance) -> NDArray[np.uint8]:
    """Tint where two or more robots reach; areas that no camera sees are pale."""
    x = np.array([RASTER.world_from_pixel(0, c)[0] for c in range(RASTER.columns)])
    y = np.array([RASTER.world_from_pixel(r, 0)[1] for r in range(RASTER.rows)])
    at_work = np.zeros((RASTER.rows, RASTER.columns), np.int64)
    for placed in instance.scene.robots:
        at_work += reach_map(placed.arm, placed.base, x, y) > 0.0
    rgb = fused.rgb.astype(np.float64)
    flat = (at_work > 1) & (np.abs(fused.height_m) < 0.003)
    rgb[flat] = 0.72 * rgb[flat] + 0.28 * _SHARED_TINT
    rgb[~fused.coverage] = _NOT_SEEN
    return rgb.astype(np.uint8)


def _name_entities(
    canvas: Canvas, instance: Instance, scene: Scene, width: int
) -> None:
    """Draw goal arrows, then names over them."""
    size, places = width / 62, {}
    for name in instance.scene.object_names:
        pose = scene.pose2(name)
        if name == STICK:
            pose = pose @ Pose2(HANDLE_LENGTH_M / 2, 0.0)
        places[name] = pixel_of(pose.x, pose.y, width)
    occupied = []
    for top, bottom in instance.goal.pairs:
        if HAND in (top, bottom):
            at = places[bottom if top == HAND else top]
            canvas.circle(at, 1.1 * size, _GOAL_INK, 0.28 * size)
            continue
        start, end = _shorten(places[top], places[bottom], 1.1 * size)
        canvas.arrow(start, end, _GOAL_INK, 0.28 * size)
        occupied += [_around(start, size), _around(end, size)]
    labels = [(at, name, _ink_of(name), 2.0) for name, at in places.items()]
    titles = robot_titles(instance).items()
    for (name, title), placed in zip(titles, instance.scene.robots, strict=True):
        at = pixel_of(placed.base.x, placed.base.y, width)
        labels.append((at, f"{name}: {title}", ROBOT_INK[placed.color], 3.2))
    occupied += [_around(at, 0.8 * size) for at, *_ in labels]
    for at, text, ink, away in labels:
        canvas.label(at, text, size, ink, away * size, occupied)


def _ink_of(entity: str) -> Color:
    found = entity_named(entity)
    red, green, blue = (round(255 * part) for part in found.rgba[:3])
    return ENTITY_INK.get(found.color or found.name, (red, green, blue))


def _around(point: Point, radius: float) -> Box:
    x, y = point
    return (x - radius, y - radius), (x + radius, y + radius)


def _shorten(start: Point, end: Point, gap: float) -> tuple[Point, Point]:
    """Shorten an arrow at both ends, so that it hides no object."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    share = min(gap / length, 0.3) if length else 0.0
    return (
        (start[0] + share * dx, start[1] + share * dy),
        (end[0] - share * dx, end[1] - share * dy),
    )
