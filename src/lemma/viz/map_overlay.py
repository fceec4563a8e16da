"""The top-down map with reach, names and goal."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lemma.core.poses import Pose2
from lemma.robots.could import could_of
from lemma.robots.reach import reach_map, reach_of
from lemma.scene.cameras import CameraImage
from lemma.scene.objects.entity import STICK, entity_named
from lemma.scene.objects.stick import HANDLE_LENGTH_M
from lemma.scene.raster import RASTER, MapImage, Raster
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
    label_plate,
)
from lemma.viz.recording import robot_titles

Pixel = Callable[[float, float], Point]
"""From a position on the table [m] to a point of the picture."""

_GOAL_INK: Color = (190, 40, 160)
_NOT_SEEN = (214, 216, 219)
_SHARED_TINT = np.array([255, 238, 170], dtype=np.float64)


def annotated_map(
    instance: Instance,
    scene: Scene,
    images: list[CameraImage],
    width: int,
    raster: Raster = RASTER,
) -> Image.Image:
    """Return the map of a scene with reach, names and goal drawn on it.

    Where a robot surely works is bounded by a solid circle, what it could touch at most
    by a dashed one.

    Args:
        instance: Of the scene.
        scene: Its scene, in the state to draw.
        images: Of its cameras.
        width: Width of the picture [px]; its height follows.
        raster: The raster of the map.
    """
    fused = fuse(images, raster)
    scale = width / raster.columns
    picture = Image.fromarray(_shade(fused, instance, raster)).resize(
        (width, round(raster.rows * scale)), Image.Resampling.BICUBIC
    )
    canvas = Canvas(picture)

    def pixel(x: float, y: float) -> Point:
        return (
            (raster.columns / 2 + x / raster.cell_m) * scale,
            (raster.rows / 2 - y / raster.cell_m) * scale,
        )

    size = width / 62
    metre = scale / raster.cell_m
    for placed in instance.scene.robots:
        reach, could = reach_of(placed.arm), could_of(placed.arm)
        centre = pixel(placed.base.x, placed.base.y)
        # A dark edge, because white would not be seen on what is pale.
        for ink, width_px in ((INK, 0.30), (ROBOT_INK[placed.color], 0.18)):
            thick = width_px * size
            canvas.ring(centre, could.touch_m * metre, ink, 0.7 * thick, dash=size / 2)
            canvas.ring(centre, reach.travel_m * metre, ink, thick)
            canvas.ring(centre, reach.inner_m * metre, ink, thick)
    _name_entities(canvas, instance, scene, pixel, picture.size, size)
    return canvas.picture()


def _shade(fused: MapImage, instance: Instance, raster: Raster) -> NDArray[np.uint8]:
    """Tint the region that all robots reach; pale where no camera sees anything."""
    x, y = np.empty(raster.columns), np.empty(raster.rows)
    for column in range(raster.columns):
        x[column], _ = raster.world_from_pixel(0, column)
    for row in range(raster.rows):
        _, y[row] = raster.world_from_pixel(row, 0)
    shared = np.ones((raster.rows, raster.columns), np.bool_)
    for placed in instance.scene.robots:
        shared &= reach_map(placed.arm, placed.base, x, y) > 0.0
    rgb = fused.rgb.astype(np.float64)
    flat = shared & (np.abs(fused.height_m) < 0.003)
    rgb[flat] = 0.72 * rgb[flat] + 0.28 * _SHARED_TINT
    rgb[~fused.coverage] = _NOT_SEEN
    return rgb.astype(np.uint8)


def _name_entities(
    canvas: Canvas,
    instance: Instance,
    scene: Scene,
    pixel: Pixel,
    within: Point,
    size: float,
) -> None:
    """Draw goal arrows, then names over them."""
    places = {}
    for name in instance.scene.object_names:
        pose = scene.pose2(name)
        if name == STICK:
            pose = pose @ Pose2(HANDLE_LENGTH_M / 2, 0.0)
        places[name] = pixel(pose.x, pose.y)
    taken = []
    for top, bottom in instance.goal.pairs:
        start, end = _shorten(places[top], places[bottom], 1.1 * size)
        canvas.arrow(start, end, _GOAL_INK, 0.28 * size)
        taken += [_around(start, size), _around(end, size)]
    titles, names = robot_titles(instance), instance.scene.robot_names
    labels = [(at, name, _ink_of(name), 2.0) for name, at in places.items()]
    for i, placed in enumerate(instance.scene.robots):
        at = pixel(placed.base.x, placed.base.y)
        labels.append((at, f"{names[i]}: {titles[i]}", ROBOT_INK[placed.color], 3.2))
    taken += [_around(at, 0.8 * size) for at, *_ in labels]
    for at, text, ink, away in labels:
        plate = label_plate(at, text, size, away * size, taken, within)
        taken.append(plate)
        canvas.label(plate, text, size, ink)


def _ink_of(entity: str) -> Color:
    found = entity_named(entity)
    red, green, blue = (round(255 * part) for part in found.rgba[:3])
    return ENTITY_INK.get(found.color or found.name, (red, green, blue))


def _around(point: Point, radius: float) -> Box:
    x, y = point
    return (x - radius, y - radius), (x + radius, y + radius)


def _shorten(start: Point, end: Point, gap: float) -> tuple[Point, Point]:
    """Move both ends of an arrow towards each other, so that they hide nothing."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    share = min(gap / length, 0.3) if length else 0.0
    return (
        (start[0] + share * dx, start[1] + share * dy),
        (end[0] - share * dx, end[1] - share * dy),
    )
