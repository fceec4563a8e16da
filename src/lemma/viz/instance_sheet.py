"""One picture of an instance: cameras, depth, map, reach, goal and sentences."""

import math

import numpy as np
from PIL import Image

from lemma.env.simulation import Simulation
from lemma.scene.cameras import CameraImage, DepthImage
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.language.template import KINDS
from lemma.viz.annotate import (
    FAINT,
    INK,
    PAPER,
    Canvas,
    Point,
    false_color,
    fitting_size,
)
from lemma.viz.camera_fit import outline, overview
from lemma.viz.map_overlay import annotated_map
from lemma.viz.recording import main_sentence, robot_titles

SHEET_WIDTH_PX = 1900
SHEET_HEIGHT_PX = 1540

_EDGE_PX = 36
_GAP_PX = 20
_INNER_PX = SHEET_WIDTH_PX - 2 * _EDGE_PX
_HEAD_PX = 212
_TITLE_PX = 34
_MAP_PX = 842
_VIEW_PX = _INNER_PX - _MAP_PX - _GAP_PX
_SCALE_TICKS = 5


def instance_sheet(instance: Instance) -> Image.Image:
    """Return cameras, depth, map, reach, goal and instructions of an instance.

    Args:
        instance: The problem; it is drawn in its first state.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    scene = Simulation(instance.scene).scene
    scene.refresh()
    renderer = Renderer()
    images = [
        renderer.rgbd(scene.model, scene.data, f"{name}/camera")
        for name in instance.scene.robot_names
    ]
    top = annotated_map(instance, scene, images, _MAP_PX)
    view = _pretty_view(scene, _VIEW_PX, top.height)
    tiles = [(_EDGE_PX, view, "Overview")]
    tiles.append(
        (
            _EDGE_PX + _VIEW_PX + _GAP_PX,
            top,
            "Top-down map of both cameras: works (solid), could touch (dashed), shared "
            "region (tinted), goal (arrows)",
        )
    )
    sheet = Image.new("RGB", (SHEET_WIDTH_PX, SHEET_HEIGHT_PX), PAPER[:3])
    notes: list[tuple[Point, str]] = []
    y = _HEAD_PX
    for x, picture, title in tiles:
        notes.append(((x, y + _TITLE_PX - 10), title))
        sheet.paste(picture, (x, y + _TITLE_PX))
    y += _TITLE_PX + top.height + _GAP_PX
    pictures = _camera_pictures(instance, images)
    width = (_INNER_PX - _GAP_PX * (len(pictures) - 1)) // len(pictures)
    for i, (picture, title) in enumerate(pictures):
        x = _EDGE_PX + i * (width + _GAP_PX)
        size = (width, round(width * picture.height / picture.width))
        notes.append(((x, y + _TITLE_PX - 10), title))
        sheet.paste(picture.resize(size, Image.Resampling.LANCZOS), (x, y + _TITLE_PX))
    return _write(sheet, instance, notes)


def _pretty_view(scene: Scene, width: int, height: int) -> Image.Image:
    renderer = Renderer(width, height, "presentation")
    camera = overview(outline(scene), width / height)
    return Image.fromarray(renderer.rgb(scene.model, scene.data, camera))


def _camera_pictures(
    instance: Instance, images: list[CameraImage]
) -> list[tuple[Image.Image, str]]:
    """Return color and depth of every camera, with titles."""
    pictures = []
    low, high = _depth_range(images)
    for title, name, seen in zip(
        robot_titles(instance), instance.scene.robot_names, images, strict=True
    ):
        pictures.append((Image.fromarray(seen.rgb), f"{name} ({title}): camera"))
        pictures.append((depth_picture(seen.depth_m, low, high), f"{name}: depth"))
    return pictures


def depth_picture(depth_m: DepthImage, low_m: float, high_m: float) -> Image.Image:
    """Return a depth image in false colors, with a scale in metres below it.

    Args:
        depth_m: Distances, shape (H, W) [m]; 0 where nothing was seen.
        low_m: Drawn brightest, as is all that is nearer [m].
        high_m: Drawn darkest, as is all that is farther [m].
    """
    height, width = depth_m.shape
    rgb = np.full((height + 58, width, 3), PAPER[0], np.uint8)
    rgb[:height] = false_color(depth_m, low_m, high_m)
    rgb[:height][depth_m == 0.0] = 0
    across = np.linspace(low_m, high_m, width, dtype=np.float32)
    rgb[height + 10 : height + 24] = false_color(across, low_m, high_m)
    canvas = Canvas(Image.fromarray(rgb))
    for i in range(_SCALE_TICKS):
        share = i / (_SCALE_TICKS - 1)
        anchor = "lm" if i == 0 else "rm" if i == _SCALE_TICKS - 1 else "mm"
        text = f"{low_m + share * (high_m - low_m):.2f} m"
        canvas.text((share * width, height + 42), text, 24, FAINT, anchor)
    return canvas.picture()


def _depth_range(images: list[CameraImage]) -> tuple[float, float]:
    """Return one scale for all cameras: what lies on the table uses most colors."""
    depths = np.concatenate([seen.depth_m[seen.depth_m > 0.0] for seen in images])
    low, high = np.percentile(depths, (2.0, 95.0))
    return math.floor(low * 10) / 10, math.ceil(high * 10) / 10


def _write(
    sheet: Image.Image, instance: Instance, notes: list[tuple[Point, str]]
) -> Image.Image:
    """Add the head and the titles of the pictures."""
    canvas = Canvas(sheet)
    x, y = float(_EDGE_PX), 50.0
    main = f"“{main_sentence(instance)}”"
    canvas.text((x, y), main, fitting_size(main, 40, _INNER_PX), INK, "lm")
    y += 46
    facts = "  ·  ".join(
        [
            instance.key,
            *(
                f"{name}: {title}"
                for name, title in zip(
                    instance.scene.robot_names, robot_titles(instance), strict=True
                )
            ),
            f"distractors: {', '.join(instance.distractors) or 'none'}",
        ]
    )
    canvas.text((x, y), facts, fitting_size(facts, 20, _INNER_PX), FAINT, "lm")
    y += 42
    for kind in [kind for kind in KINDS[1:] if kind in instance.instructions]:
        canvas.text((x, y), kind.replace("_", " "), 19, FAINT, "lm")
        sentence = instance.instructions[kind]
        size = fitting_size(sentence, 24, _INNER_PX - 110)
        canvas.text((x + 100, y), sentence, size, INK, "lm")
        y += 36
    for at, title in notes:
        canvas.text(at, title, 18, FAINT, "ls")
    return canvas.picture()
