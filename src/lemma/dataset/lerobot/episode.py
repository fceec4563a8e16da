"""One episode on its way into a LeRobotDataset: films, frames and a note on them.

An episode is written as a part of its own, a folder, by whichever process. The note
comes last: where it is, the part is whole.
"""

import ctypes
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lemma.core.errors import DatasetError
from lemma.core.parallel import is_worker
from lemma.core.robot_names import robot_names
from lemma.dataset.files import read_json, write_json, write_whole
from lemma.dataset.lerobot.layout import Style, depth_key, image_key, video_keys
from lemma.dataset.lerobot.stats import Histogram, Stats, describe
from lemma.dataset.lerobot.video import (
    DEPTH,
    DEPTH_LEVEL_M,
    DEPTH_LEVELS,
    RGB,
    Film,
    levels_from_depth,
)
from lemma.dataset.recipe.reader import read_group
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.labels import label
from lemma.dataset.rendered.steps import NO_SUBTASK, DenseStep, iterate_steps
from lemma.scene.cameras import Camera, CameraImage
from lemma.scene.rendering.renderer import Renderer
from lemma.tasks.language.template import KINDS

FRAMES = "frames.parquet"
_NOTE = "episode.json"
_M_MMAP_THRESHOLD = -3
_LARGE_BYTES = 128 * 1024
LOCAL_SUBTASK = "subtask"
"""Column of a part: number of the episode's sub-task; behind the last is the end."""


@dataclass(frozen=True, slots=True)
class Source:
    """Where an episode of a recipe is."""

    path: Path
    """File."""
    group: int
    """Row group of the file."""
    row: int
    """Row of the group."""


@dataclass(frozen=True, slots=True)
class Note:
    """What is known of a part without looking into it."""

    key: str
    task: str
    split: str
    index: int
    team: str
    distractors: int
    success: bool
    robots: list[str]
    """Names of the robots."""
    instructions: dict[str, str]
    """Sentence by kind."""
    subtasks: list[str]
    """The sub-tasks in words, and what is said at the end."""
    length: int
    """Frames."""
    size_bytes: dict[str, int]
    """Of each video by key, and of :data:`FRAMES`."""
    cameras: dict[str, dict[str, list[float]]]
    """Of each robot: ``intrinsics`` fx, fy, cx, cy [px] and ``world_from_camera``, a
    transform (x right, y down, z forward), 16 numbers, row by row [m]."""
    stats: dict[str, Stats]
    """Figures of every feature that depends on nothing but the episode."""


def film_name(key: str) -> str:
    """Return the name of a part's video."""
    return f"{key}.mp4"


def read_note(part: Path) -> Note:
    """Read what is known of a part.

    Raises:
        DatasetError: It is damaged.
    """
    try:
        return Note(**read_json(part / _NOTE))
    except TypeError as error:
        raise DatasetError(
            f"{part} was written by another version. Delete the folder that you "
            "export to, and export again."
        ) from error


def is_whole(part: Path) -> bool:
    """Return whether a part was written to its end."""
    return (part / _NOTE).exists()


def write_part(source: Source, part: Path, style: Style) -> int:
    """Film an episode and write it as a part; return 1, the number of episodes.

    Args:
        source: The episode.
        part: The folder to write.
        style: How to film it.

    Raises:
        DatasetError: The motion is not the recorded one, or the part cannot be written.
        RenderingError: OpenGL does not work here.
    """
    if is_worker():
        # Mesa would start as many threads as there are cores, in each process.
        os.environ.setdefault("LP_NUM_THREADS", "0")
        _return_memory()
    record = read_group(source.path, source.group)[source.row]
    names = robot_names(len(record.instance_data()["robots"]))
    studio = _Studio(names, style)
    steps: list[dict[str, Any]] = []
    for step in iterate_steps(record, style.fps):
        studio.shoot(step)
        steps.append(_row(record, step))
    table = _table(steps)
    stats = {name: describe(_columns(table, name)) for name in table.column_names}
    del stats[LOCAL_SUBTASK]
    write_whole(part / FRAMES, partial(pq.write_table, table))
    sizes = {FRAMES: (part / FRAMES).stat().st_size}
    for key, film in studio.finish().items():
        path = part / film_name(key)
        write_whole(path, partial(_put, film))
        sizes[key] = len(film)
    ends = range(len(record.subtasks) + 1)
    note = Note(
        key=record.key,
        task=record.task,
        split=record.split,
        index=record.index,
        team=record.team,
        distractors=record.distractors,
        success=record.success,
        robots=list(names),
        instructions={kind: getattr(record, kind) for kind in KINDS},
        subtasks=[label(record, number)["sub_instruction"] for number in ends],
        length=len(steps),
        size_bytes=sizes,
        cameras={name: _calibration(camera) for name, camera in studio.cameras.items()},
        stats={**stats, **studio.describe()},
    )
    write_json(part / _NOTE, asdict(note))
    return 1


def _return_memory() -> None:
    """Let what pictures took go back to the system, instead of piling up in pieces."""
    with suppress(OSError, AttributeError):
        # Where the C library is glibc. Otherwise it raises the limit by itself.
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)


def _put(content: bytes, path: Path) -> None:
    path.write_bytes(content)


class _Studio:
    """The cameras of an episode, each with its films."""

    def __init__(self, robots: tuple[str, ...], style: Style) -> None:
        self._robots = robots
        self._style = style
        self._renderer = _renderer(style.width_px, style.height_px)
        self._films = {
            key: Film(
                DEPTH if key in map(depth_key, robots) else RGB,
                style.width_px,
                style.height_px,
                style.fps,
            )
            for key in video_keys(robots, style)
        }
        self._colors = {robot: Histogram(3, 256) for robot in robots}
        self._depths = {robot: Histogram(1, DEPTH_LEVELS) for robot in robots}
        self.cameras: dict[str, Camera] = {}

    def shoot(self, step: DenseStep) -> None:
        """Add a picture to every film."""
        scene = step.scene
        for robot in self._robots:
            name = f"{robot}/camera"
            image = self._renderer.rgbd(scene.model, scene.data, name)
            self._keep(robot, image)
            self.cameras[robot] = image.camera

    def _keep(self, robot: str, image: CameraImage) -> None:
        self._films[image_key(robot)].add(image.rgb)
        self._colors[robot].add(image.rgb)
        if self._style.depth:
            levels = levels_from_depth(image.depth_m)
            self._films[depth_key(robot)].add(levels)
            self._depths[robot].add(levels)

    def finish(self) -> dict[str, bytes]:
        """Return the finished films by key."""
        return {key: film.finish() for key, film in self._films.items()}

    def describe(self) -> dict[str, Stats]:
        """Return the figures of every film: color in [0, 1], depth in metres."""
        found = {}
        for robot in self._robots:
            found[image_key(robot)] = self._colors[robot].describe(1.0 / 255.0)
            if self._style.depth:
                found[depth_key(robot)] = self._depths[robot].describe(DEPTH_LEVEL_M)
        return found


@lru_cache(maxsize=1)
def _renderer(width_px: int, height_px: int) -> Renderer:
    """Return the renderer of this process: starting one takes longer than a picture."""
    return Renderer(width_px, height_px)


def _calibration(camera: Camera) -> dict[str, list[float]]:
    lens = camera.intrinsics
    return {
        "intrinsics": [lens.fx, lens.fy, lens.cx, lens.cy],
        "world_from_camera": camera.world_from_camera.matrix().ravel().tolist(),
    }


def _row(record: EpisodeRecord, step: DenseStep) -> dict[str, Any]:
    measured = np.concatenate([step.joints, step.opening_m[:, None]], axis=1)
    last = len(record.subtasks)
    return {
        "observation.state": measured.ravel().astype(np.float32),
        "action": step.action.ravel().astype(np.float32),
        "next.reward": step.reward,
        "next.done": step.is_done,
        "next.success": step.is_done and record.success,
        "timestamp": step.time_s,
        "frame_index": step.index,
        LOCAL_SUBTASK: last if step.subtask == NO_SUBTASK else step.subtask,
    }


def _table(rows: list[dict[str, Any]]) -> pa.Table:
    vector = pa.list_(pa.float32(), len(rows[0]["action"]))
    schema = pa.schema(
        {
            "observation.state": vector,
            "action": vector,
            "next.reward": pa.float32(),
            "next.done": pa.bool_(),
            "next.success": pa.bool_(),
            "timestamp": pa.float32(),
            "frame_index": pa.int64(),
            LOCAL_SUBTASK: pa.int64(),
        }
    )
    return pa.Table.from_pylist(rows, schema=schema)


def _columns(table: pa.Table, name: str) -> list[Any]:
    values: list[Any] = table[name].to_pylist()
    return values
