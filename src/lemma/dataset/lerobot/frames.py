"""What a frame of a LeRobotDataset holds: states, commands, images and sentences.

Nothing here needs the lerobot package.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.robot_names import robot_names
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.labels import label
from lemma.dataset.rendered.steps import (
    NO_SUBTASK,
    DenseStep,
    iterate_steps,
    ticks_per_step,
)
from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.env.view import View
from lemma.robots.ur.build import JOINTS
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.scene.model_cameras import camera_from_model
from lemma.tasks.instance import Instance
from lemma.tasks.language.template import KINDS

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
    """Whether depth is filmed too."""
    instruction: str = "high_level"
    """Which of the three instructions is the ``task`` of a frame."""

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


def image_key(robot: str) -> str:
    """Return the name of a robot's camera as a feature."""
    return f"observation.images.{robot}"


def depth_key(robot: str) -> str:
    """Return the name of the depth of a robot's camera as a feature."""
    return f"observation.images.{robot}_depth"


def robots_of(record: EpisodeRecord) -> tuple[str, ...]:
    """Return the names of an episode's robots."""
    return robot_names(len(record.instance_data()["robots"]))


def features(robots: tuple[str, ...], style: Style) -> dict[str, dict[str, Any]]:
    """Return what a frame consists of, in the words of the format.

    Args:
        robots: Names of the robots.
        style: How they are filmed.
    """
    motors = [f"{robot}.{motor}" for robot in robots for motor in (*JOINTS, "gripper")]
    sides = (style.height_px, style.width_px)
    found = {
        "observation.state": _feature("float32", (len(motors),), motors),
        "action": _feature("float32", (len(motors),), motors),
        "next.reward": _feature("float32"),
        "next.done": _feature("bool"),
        "next.success": _feature("bool"),
        "subtask": _feature("string"),
        **{f"annotation.instruction.{kind}": _feature("string") for kind in KINDS},
    }
    axes = ["height", "width", "channels"]
    for robot in robots:
        found[image_key(robot)] = _feature("video", (*sides, 3), axes)
    for robot in robots if style.depth else ():
        depth = _feature("video", (*sides, 1), axes)
        found[depth_key(robot)] = {**depth, "info": {"is_depth_map": True}}
    return found


def _feature(
    dtype: str, shape: tuple[int, ...] = (1,), names: list[str] | None = None
) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "names": names}


def frames(record: EpisodeRecord, style: Style) -> Iterator[dict[str, Any]]:
    """Yield the frames of an episode, each with its ``task``.

    Args:
        record: The episode; its sub-tasks are executed again.
        style: How to film it.

    Raises:
        DatasetError: The motion is not the recorded one.
        RenderingError: OpenGL does not work here.
    """
    rig = _rig(style.width_px, style.height_px)
    said = {f"annotation.instruction.{kind}": getattr(record, kind) for kind in KINDS}
    task = getattr(record, style.instruction)
    for step in iterate_steps(record, style.fps):
        view = rig.look(step.scene)
        yield {
            **_numbers(record, step, view),
            **_images(view, robots_of(record), style),
            **said,
            "task": task,
        }


@lru_cache(maxsize=1)
def _rig(width_px: int, height_px: int) -> CameraRig:
    """Return the cameras of this process: starting them takes longer than a picture."""
    return CameraRig(width_px, height_px)


def _numbers(record: EpisodeRecord, step: DenseStep, view: View) -> dict[str, Any]:
    state = np.concatenate([view.joints, view.opening_m[:, None]], axis=1)
    last = len(record.subtasks)
    number = last if step.subtask == NO_SUBTASK else step.subtask
    is_success = step.is_done and record.success
    return {
        "observation.state": state.ravel().astype(np.float32),
        "action": step.action.ravel().astype(np.float32),
        "next.reward": np.array([step.reward], np.float32),
        "next.done": np.array([step.is_done]),
        "next.success": np.array([is_success]),
        "subtask": label(record, number)["sub_instruction"],
    }


def _images(view: View, robots: tuple[str, ...], style: Style) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for robot in robots:
        image = view.cameras[robot]
        found[image_key(robot)] = image.rgb
        if style.depth:
            found[depth_key(robot)] = image.depth_m[..., None]
    return found


def describe_episode(
    record: EpisodeRecord, style: Style, length: int
) -> dict[str, Any]:
    """Return what the format has no place for: where an episode comes from, cameras.

    Args:
        record: The episode.
        style: How it was filmed.
        length: How many frames it has.
    """
    cameras = {}
    scene = Episode(Instance.from_dict(record.instance_data())).simulation.scene
    scene.refresh()
    for robot in robots_of(record):
        size = (style.width_px, style.height_px)
        camera = camera_from_model(scene.model, scene.data, f"{robot}/camera", *size)
        lens = camera.intrinsics
        cameras[robot] = {
            "intrinsics_px": [lens.fx, lens.fy, lens.cx, lens.cy],
            "world_from_camera": camera.world_from_camera.matrix().tolist(),
        }
    return {
        "key": record.key,
        "task": record.task,
        "split": record.split,
        "index": record.index,
        "team": record.team,
        "distractors": record.distractors,
        "success": record.success,
        "length": length,
        "instructions": {kind: getattr(record, kind) for kind in KINDS},
        "subtasks": [row.instruction for row in record.subtasks],
        "cameras": cameras,
    }
