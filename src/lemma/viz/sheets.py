"""Sheets: an instance in one picture, and the keyframes of an episode in another."""

import math
from pathlib import Path

import numpy as np
from PIL import Image

from lemma.core.errors import InvalidConfigError
from lemma.core.files import write_whole
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.env.simulation import Simulation
from lemma.scene.cameras import CameraImage, DepthImage
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.language.template import KINDS
from lemma.viz.annotate import (
    BAD,
    FAINT,
    GOOD,
    INK,
    PAPER,
    Canvas,
    Point,
    false_color,
    fitting_size,
    wrap,
)
from lemma.viz.camera_fit import views
from lemma.viz.map_overlay import annotated_map, camera_images
from lemma.viz.recording import main_sentence, robot_titles

SHEET_WIDTH_PX = 1900
SHEET_HEIGHT_PX = 1540

_EDGE_PX = 36
_GAP_PX = 20
_INNER_PX = SHEET_WIDTH_PX - 2 * _EDGE_PX
_HEAD_PX = 212
_TITLE_PX = 34
_MAP_PX = 842
_SCALE_TICKS = 5
_KEYFRAME_PX = (620, 400)
_KEYFRAME_HEAD_PX = 138
_FOOT_PX = 66
_FOOT_TEXT_PX = 20
_MOST_COLUMNS = 3
_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}
_MAP_TITLE = (
    "Top-down map of all cameras: works (solid), could touch (dashed), shared region "
    "(tinted), goal (arrows)"
)


def check_picture_path(path: Path) -> None:
    """Check that a picture can be written under a name.

    Raises:
        InvalidConfigError: It is a folder, or its ending is not that of a picture.
    """
    if path.is_dir():
        raise InvalidConfigError(
            f"{path} is a folder. Name a file, such as {path / 'picture.png'}."
        )
    above = next(parent for parent in path.absolute().parents if parent.exists())
    if not above.is_dir():
        raise InvalidConfigError(f"{above} is a file, so {path} cannot be written.")
    if path.suffix.lower() not in _FORMATS:
        raise InvalidConfigError(
            f"{path} does not end like a picture. Valid endings: {', '.join(_FORMATS)}."
        )


def save_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture in the format of its name's ending.

    Raises:
        DatasetError: It cannot be written there.
    """
    kind = _FORMATS[path.suffix.lower()]
    write_whole(path, lambda draft: picture.save(draft, kind))


def instance_sheet(instance: Instance) -> Image.Image:
    """Return cameras, depth, map, reach, goal and instructions of an instance.

    Args:
        instance: The problem; its initial state is drawn.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    scene = Simulation(instance.scene).scene
    images = camera_images(scene)
    top = annotated_map(instance, scene, images, _MAP_PX)
    size = (_INNER_PX - _MAP_PX - _GAP_PX, top.height)
    (view,) = views(scene, [scene.snapshot()], size, "presentation")
    sheet = Image.new("RGB", (SHEET_WIDTH_PX, SHEET_HEIGHT_PX), PAPER)
    notes: list[tuple[Point, str]] = []

    def paste(picture: Image.Image, x: int, y: int, title: str) -> None:
        notes.append(((x, y + _TITLE_PX - 10), title))
        sheet.paste(picture, (x, y + _TITLE_PX))

    paste(view, _EDGE_PX, _HEAD_PX, "Overview")
    paste(top, _EDGE_PX + view.width + _GAP_PX, _HEAD_PX, _MAP_TITLE)
    pictures = _camera_pictures(instance, images)
    width = (_INNER_PX - _GAP_PX * (len(pictures) - 1)) // len(pictures)
    for i, (picture, title) in enumerate(pictures):
        size = (width, round(width * picture.height / picture.width))
        small = picture.resize(size, Image.Resampling.LANCZOS)
        below = _HEAD_PX + _TITLE_PX + top.height + _GAP_PX
        paste(small, _EDGE_PX + i * (width + _GAP_PX), below, title)
    canvas = Canvas(sheet)
    distractors = f"distractors: {', '.join(instance.distractors) or 'none'}"
    facts = [instance.key, *_robots(instance), distractors]
    _write_head(canvas, main_sentence(instance), 40, facts, (50.0, 96.0), _INNER_PX)
    y = 138
    for kind in [kind for kind in KINDS[1:] if kind in instance.instructions]:
        canvas.text((_EDGE_PX, y), kind.replace("_", " "), 19, FAINT, "lm")
        sentence = instance.instructions[kind]
        letters = fitting_size(sentence, 24, _INNER_PX - 110)
        canvas.text((_EDGE_PX + 100, y), sentence, letters, INK, "lm")
        y += 36
    for at, title in notes:
        canvas.text(at, title, 18, FAINT, "ls")
    return canvas.picture()


def _robots(instance: Instance) -> list[str]:
    """Return name and title of every robot."""
    return [f"{name}: {title}" for name, title in robot_titles(instance).items()]


def _write_head(
    canvas: Canvas,
    sentence: str,
    size_px: float,
    facts: list[str],
    rows_px: tuple[float, float],
    width_px: float,
) -> None:
    """Write a sentence, and facts below it."""
    title, text = f"“{sentence}”", "  ·  ".join(facts)
    size_px = fitting_size(title, size_px, width_px)
    canvas.text((_EDGE_PX, rows_px[0]), title, size_px, INK, "lm")
    size_px = fitting_size(text, 20, width_px)
    canvas.text((_EDGE_PX, rows_px[1]), text, size_px, FAINT, "lm")


def _camera_pictures(
    instance: Instance, images: list[CameraImage]
) -> list[tuple[Image.Image, str]]:
    """Return color and depth of every camera, with titles.

    All depth images have one scale; objects on the table use most of its colors.
    """
    depths = np.concatenate([seen.depth_m[seen.depth_m > 0.0] for seen in images])
    low, high = np.percentile(depths, (2.0, 95.0))
    low, high = math.floor(low * 10) / 10, math.ceil(high * 10) / 10
    pictures = []
    titles = robot_titles(instance).items()
    for (name, title), seen in zip(titles, images, strict=True):
        # There is no room for the hand over the small image.
        arm = title.partition(",")[0]
        pictures.append((Image.fromarray(seen.rgb), f"{name} ({arm}): camera"))
        pictures.append((depth_picture(seen.depth_m, low, high), f"{name}: depth"))
    return pictures


def depth_picture(depth_m: DepthImage, low_m: float, high_m: float) -> Image.Image:
    """Return a depth image in false colors, with a scale in metres below it.

    Args:
        depth_m: Distances, shape (H, W) [m]; 0 for no measurement.
        low_m: Distance of the brightest color [m]; smaller ones have the same.
        high_m: Distance of the darkest color [m]; larger ones have the same.
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


def keyframe_strip(record: EpisodeRecord) -> Image.Image:
    """Return the keyframes of an episode, each with the next sub-task.

    Args:
        record: The episode; its recorded states are drawn without simulation.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    instance = Instance.from_dict(record.instance_data())
    states = [record.state(keyframe) for keyframe in range(record.keyframes)]
    pictures = views(Scene(instance.scene), states, _KEYFRAME_PX, "presentation")
    columns = min(_MOST_COLUMNS, len(pictures))
    width, height = _KEYFRAME_PX
    inner = columns * (width + _GAP_PX) - _GAP_PX
    pitch = height + _FOOT_PX + _GAP_PX
    rows = math.ceil(len(pictures) / columns)
    size = (inner + 2 * _EDGE_PX, _KEYFRAME_HEAD_PX + rows * pitch + _GAP_PX)
    sheet = Image.new("RGB", size, PAPER)
    corners = []
    for i, picture in enumerate(pictures):
        x = _EDGE_PX + (i % columns) * (width + _GAP_PX)
        corners.append((x, _KEYFRAME_HEAD_PX + (i // columns) * pitch))
        sheet.paste(picture, corners[-1])
    canvas = Canvas(sheet)
    facts = [record.key, *_robots(instance), f"{record.elapsed_s:.1f} simulated s"]
    _write_head(canvas, record.high_level, 36, facts, (48, 94), inner)
    for keyframe, (x, y) in enumerate(corners):
        # The next sub-task, or the end of the episode.
        text, ink = f"Not solved: {record.failure}.", BAD
        if keyframe < len(record.subtasks):
            text = f"{keyframe + 1}. {record.subtasks[keyframe].instruction}"
            ink = INK
        elif record.success:
            text, ink = "Solved.", GOOD
        y += height + 20
        clock = f"{record.keyframe_time_s[keyframe]:.1f} s"
        canvas.text((x + width, y), clock, _FOOT_TEXT_PX, FAINT, "rm")
        for line in wrap(text, _FOOT_TEXT_PX, width - 80)[:2]:
            canvas.text((x, y), line, _FOOT_TEXT_PX, ink, "lm")
            y += 26
    return canvas.picture()
