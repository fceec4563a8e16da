"""The published layout of LeRobotDataset v3.0: names, paths and features.

Many episodes share one file; ``meta/episodes`` says which rows and which seconds of
which files are whose. What is ours beside the format has names of its own: columns
``annotation.*`` of the frames, columns ``lemma/*`` and ``camera/*`` of the episodes,
and the folder ``extras``.
"""

import math
from dataclasses import dataclass
from typing import Any

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.dataset.lerobot.video import DEPTH, RGB
from lemma.dataset.rendered.steps import ticks_per_step
from lemma.robots.ur.build import JOINTS
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.tasks.language.template import KINDS

CODEBASE_VERSION = "v3.0"
FILES_PER_CHUNK = 1000
LONGEST_VIDEO_S = 1000.0
"""Duration that no video of several episodes exceeds [s].

Readers look frames up by time in float32, to within 0.1 ms: beyond 1024 s neighbouring
float32 numbers are further apart than that.
"""
EPISODES_PER_FILE = 1000
"""Rows of one file in ``meta/episodes``."""

INFO = "meta/info.json"
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
SUBTASKS = "meta/subtasks.parquet"
EXTRAS = "extras"
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_EPISODES = f"meta/episodes/{_FILE}.parquet"
_DATA = f"data/{_FILE}.parquet"
_VIDEO = "videos/{video_key}/" + _FILE + ".mp4"

_SMALLEST_PX = 32


@dataclass(frozen=True, kw_only=True)
class Style:
    """How episodes are sampled and filmed."""

    fps: int = 10
    """Frames per simulated second: a divisor of 100."""
    width_px: int = CAMERA_WIDTH_PX
    """Width of the pictures [px]; even."""
    height_px: int = CAMERA_HEIGHT_PX
    """Height of the pictures [px]; even."""
    depth: bool = True
    """Whether depth is filmed too. Readers before lerobot 0.6 take it for color."""
    instruction: str = "high_level"
    """Which of the three instructions is the ``task`` of a frame."""
    data_file_mb: float = 100.0
    """Size at which the next file of frames is begun [MiB]."""
    video_file_mb: float = 200.0
    """Size at which the next video is begun [MiB]."""
    video_file_s: float = LONGEST_VIDEO_S
    """Duration at which the next video is begun [s]."""

    def __post_init__(self) -> None:
        """Check that it can be done."""
        ticks_per_step(self.fps)
        sides = (self.width_px, self.height_px)
        if min(sides) < _SMALLEST_PX or any(side % 2 for side in sides):
            raise InvalidConfigError(
                f"Pictures of {self.width_px} x {self.height_px} pixels cannot be "
                f"encoded. Both sides must be even and at least {_SMALLEST_PX}."
            )
        if self.instruction not in KINDS:
            raise UnknownNameError("kind of instruction", self.instruction, KINDS)
        if self.video_file_s > LONGEST_VIDEO_S:
            raise InvalidConfigError(
                f"Readers cannot tell the frames of a video of {self.video_file_s:g} s "
                f"apart. Choose at most {LONGEST_VIDEO_S:g} s."
            )


def image_key(robot: str) -> str:
    """Return the name of a robot's camera as a feature."""
    return f"observation.images.{robot}"


def depth_key(robot: str) -> str:
    """Return the name of the depth of a robot's camera as a feature."""
    return f"observation.images.{robot}_depth"


def instruction_key(kind: str) -> str:
    """Return the name of the column with the task index of one kind of instruction."""
    return f"annotation.instruction.{kind}"


def video_keys(robots: tuple[str, ...], style: Style) -> tuple[str, ...]:
    """Return the features that are videos."""
    depths = map(depth_key, robots) if style.depth else ()
    return (*map(image_key, robots), *depths)


def motor_names(robots: tuple[str, ...]) -> list[str]:
    """Return the names of the elements of a state or an action."""
    return [f"{robot}.{motor}" for robot in robots for motor in (*JOINTS, "gripper")]


def features(robots: tuple[str, ...], style: Style) -> dict[str, dict[str, Any]]:
    """Return what a frame consists of, in the words of the format.

    Args:
        robots: Names of the robots.
        style: How they are filmed.
    """
    motors = motor_names(robots)
    found: dict[str, dict[str, Any]] = {
        "observation.state": _feature("float32", len(motors), motors),
        "action": _feature("float32", len(motors), motors),
    }
    for robot in robots:
        found[image_key(robot)] = {
            "dtype": "video",
            "shape": [style.height_px, style.width_px, 3],
            "names": ["height", "width", "channels"],
            "info": RGB.info(style.width_px, style.height_px, style.fps),
        }
    for robot in robots if style.depth else ():
        found[depth_key(robot)] = {
            "dtype": "video",
            "shape": [style.height_px, style.width_px, 1],
            "names": ["height", "width", "channels"],
            "info": DEPTH.info(style.width_px, style.height_px, style.fps),
        }
    found["next.reward"] = _feature("float32")
    found["next.done"] = _feature("bool")
    found["next.success"] = _feature("bool")
    found["timestamp"] = _feature("float32")
    names = ["frame_index", "episode_index", "index", "task_index", "subtask_index"]
    for name in [*names, *map(instruction_key, KINDS)]:
        found[name] = _feature("int64")
    return found


def _feature(
    dtype: str, size: int = 1, names: list[str] | None = None
) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [size], "names": names}


def info(
    robots: tuple[str, ...],
    style: Style,
    *,
    episodes: int,
    frames: int,
    tasks: int,
    splits: dict[str, str],
) -> dict[str, Any]:
    """Return what ``meta/info.json`` says.

    Args:
        robots: Names of the robots.
        style: How they are filmed.
        episodes: How many there are.
        frames: How many there are in all episodes.
        tasks: How many sentences there are.
        splits: Name of a split to the range of its episodes, ``"0:5600"``.
    """
    return {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": "lemma_team",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": math.ceil(style.data_file_mb),
        "video_files_size_in_mb": math.ceil(style.video_file_mb),
        "fps": style.fps,
        "splits": splits,
        "data_path": _DATA,
        "video_path": _VIDEO,
        "features": features(robots, style),
    }


def chunk_and_file(number: int) -> tuple[int, int]:
    """Return the chunk of a file, and its number there."""
    return divmod(number, FILES_PER_CHUNK)


def data_path(number: int) -> str:
    """Return where a file of frames is."""
    chunk, file = chunk_and_file(number)
    return _DATA.format(chunk_index=chunk, file_index=file)


def video_path(key: str, number: int) -> str:
    """Return where a video is."""
    chunk, file = chunk_and_file(number)
    return _VIDEO.format(video_key=key, chunk_index=chunk, file_index=file)


def episodes_path(number: int) -> str:
    """Return where a file of ``meta/episodes`` is."""
    chunk, file = chunk_and_file(number)
    return _EPISODES.format(chunk_index=chunk, file_index=file)
