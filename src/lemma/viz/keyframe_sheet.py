"""One episode of a recipe as a picture: its keyframes and sub-tasks."""

import math

import numpy as np
from PIL import Image

from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.viz.annotate import (
    BAD,
    FAINT,
    GOOD,
    INK,
    PAPER,
    Canvas,
    Color,
    fitting_size,
    wrap,
)
from lemma.viz.camera_fit import outline, overview
from lemma.viz.recording import robot_titles

_TILE_PX = (620, 400)
_GAP_PX = 20
_EDGE_PX = 36
_HEAD_PX = 138
_FOOT_PX = 66
_SIZE_PX = 20
_MOST_COLUMNS = 3


def keyframe_strip(record: EpisodeRecord) -> Image.Image:
    """Return the keyframes of an episode, each with the sub-task that follows.

    Args:
        record: The episode; its states are drawn, nothing is simulated.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    pictures = _draw(record)
    columns = min(_MOST_COLUMNS, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    width, height = _TILE_PX
    full = 2 * _EDGE_PX + columns * width + (columns - 1) * _GAP_PX
    pitch = height + _FOOT_PX + _GAP_PX
    sheet = Image.new("RGB", (full, _HEAD_PX + rows * pitch + _GAP_PX), PAPER[:3])
    corners = []
    for i, picture in enumerate(pictures):
        x = _EDGE_PX + (i % columns) * (width + _GAP_PX)
        y = _HEAD_PX + (i // columns) * pitch
        sheet.paste(picture, (x, y))
        corners.append((x, y))
    canvas = Canvas(sheet)
    _write_head(canvas, record, full - 2 * _EDGE_PX)
    for keyframe, corner in enumerate(corners):
        _write_foot(canvas, record, keyframe, corner)
    return canvas.picture()


def _draw(record: EpisodeRecord) -> list[Image.Image]:
    """Draw every keyframe from one place, from which all of them can be seen."""
    scene = Scene(Instance.from_dict(record.instance_data()).scene)
    seen = []
    for keyframe in range(record.keyframes):
        scene.restore(record.state(keyframe))
        seen.append(outline(scene))
    width, height = _TILE_PX
    camera = overview(np.concatenate(seen), width / height)
    renderer = Renderer(width, height, "presentation")
    pictures = []
    for keyframe in range(record.keyframes):
        scene.restore(record.state(keyframe))
        pictures.append(Image.fromarray(renderer.rgb(scene.model, scene.data, camera)))
    return pictures


def _write_head(canvas: Canvas, record: EpisodeRecord, width: float) -> None:
    instance = Instance.from_dict(record.instance_data())
    title = f"“{record.high_level}”"
    canvas.text((_EDGE_PX, 48), title, fitting_size(title, 36, width), INK, "lm")
    robots = (
        f"{name}: {words}"
        for name, words in zip(
            instance.scene.robot_names, robot_titles(instance), strict=True
        )
    )
    facts = "  ·  ".join([record.key, *robots, f"{record.elapsed_s:.1f} simulated s"])
    canvas.text((_EDGE_PX, 94), facts, fitting_size(facts, 20, width), FAINT, "lm")


def _write_foot(
    canvas: Canvas, record: EpisodeRecord, keyframe: int, corner: tuple[int, int]
) -> None:
    """Write the next sub-task, or the end of the episode."""
    text, ink = _next(record, keyframe)
    clock = f"{record.keyframe_time_s[keyframe]:.1f} s"
    width, height = _TILE_PX
    x, y = corner[0], corner[1] + height + 20
    canvas.text((x + width, y), clock, _SIZE_PX, FAINT, "rm")
    for line in wrap(text, _SIZE_PX, width - 80)[:2]:
        canvas.text((x, y), line, _SIZE_PX, ink, "lm")
        y += 26


def _next(record: EpisodeRecord, keyframe: int) -> tuple[str, Color]:
    if keyframe < len(record.subtasks):
        return f"{keyframe + 1}. {record.subtasks[keyframe].instruction}", INK
    if record.success:
        return "Solved.", GOOD
    return f"Not solved: {record.failure}.", BAD
