"""Frames of a LeRobotDataset: states, commands, images and sentences.

This module does not need the lerobot package.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any, Literal, get_args

import numpy as np

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.core.robot_names import robot_names
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.capture import label
from lemma.dataset.rendered.steps import (
    NO_SUBTASK,
    DenseStep,
    iterate_steps,
    ticks_per_step,
)
from lemma.env.camera_rig import CameraRig, camera_names, close_cameras
from lemma.env.episode import Episode
from lemma.env.learning.motor_state import (
    JOINT_POSITION,
    MOTOR_CONTROLS,
    MOTORS,
    Float32Array,
    motor_names,
    tool_rows,
)
from lemma.env.observation import Observer, truth_names, truth_vector
from lemma.scene.cameras import CLOSE_PX
from lemma.scene.rendering.batch import states_at_once
from lemma.tasks.instance import Instance
from lemma.tasks.language.template import KINDS
from lemma.tasks.language.vector import NUMBERS, sentence_vector
from lemma.tasks.suite import TASKS

AGENT_PARTS = ("state", "action")
"""Columns of each robot: ``robot_0.state``."""
ENVIRONMENT_STATE = "observation.environment_state"
"""Name of the feature with further numbers, as policies of LeRobot expect it."""
EnvironmentState = Literal["none", "sentence", "privileged"]
NONE, SENTENCE, PRIVILEGED = ENVIRONMENT_STATES = get_args(EnvironmentState)
"""No such feature; :func:`lemma.tasks.language.vector.sentence_vector`; or the true
state, :func:`lemma.env.observation.truth_vector`."""
_SMALLEST_PX = 32


@dataclass(frozen=True, kw_only=True)
class Style:
    """Options of the frames: rate, images, sentences and states."""

    fps: int = 10
    """Frames per simulated second: a divisor of 100."""
    width_px: int = CLOSE_PX
    """Width of the images [px]; even."""
    height_px: int = CLOSE_PX
    """Height of the images [px]; even."""
    depth: bool = True
    """Whether to add depth."""
    cameras: tuple[str, ...] = ()
    """Names of the cameras, as in environments; if empty, those of observations at
    control level, :func:`lemma.env.camera_rig.close_cameras`."""
    instructions: tuple[str, ...] = ("high_level",)
    """Kinds of instructions; each kind adds an episode with it as ``task``."""
    images: bool = True
    """Whether to add images."""
    environment_state: str = NONE
    """Content of ``observation.environment_state``, one of
    :data:`ENVIRONMENT_STATES`."""
    control: str = JOINT_POSITION
    """Control mode of actions and state, one of
    :data:`lemma.env.learning.motor_state.MOTOR_CONTROLS`."""
    renderer: str = "opengl"
    """A name in :data:`lemma.scene.rendering.batch.BATCH_RENDERERS`."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            InvalidConfigError: A size is odd or too small, a name is listed twice, or
                cameras are named without images.
            UnknownNameError: A name is unknown.
        """
        ticks_per_step(self.fps)
        sides = (self.width_px, self.height_px)
        if min(sides) < _SMALLEST_PX or any(side % 2 for side in sides):
            raise InvalidConfigError(
                f"Pictures of {self.width_px} x {self.height_px} pixels cannot be "
                f"encoded. Both sides must be even and at least {_SMALLEST_PX}."
            )
        for kind in self.instructions:
            known("kind of instruction", kind, KINDS)
        known("environment state", self.environment_state, ENVIRONMENT_STATES)
        known("control mode of data sets", self.control, MOTOR_CONTROLS)
        for listed in (self.cameras, self.instructions):
            if len(set(listed)) < len(listed):
                raise InvalidConfigError(f"{listed} has a name twice. Name each once.")
        if self.cameras and not self.images:
            raise InvalidConfigError(
                f"Without images the cameras {', '.join(self.cameras)} have no use. "
                "Leave out the cameras, or keep the images."
            )

    def cameras_of(self, robots: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the cameras for a team.

        Raises:
            UnknownNameError: The team has no such camera.
        """
        valid, chosen = camera_names(robots), self.cameras or close_cameras(robots)
        return tuple(known("camera", n, valid) for n in chosen) if self.images else ()

    def rig(self) -> CameraRig:
        """Return the cameras of this process, which are created once."""
        return _rig(self.width_px, self.height_px, self.renderer)


@lru_cache(maxsize=1)
def _rig(width: int, height: int, renderer: str) -> CameraRig:
    """Return cached cameras, since their creation takes longer than an image."""
    return CameraRig(width, height, renderer)


def robots_of(record: EpisodeRecord) -> tuple[str, ...]:
    """Return the names of an episode's robots."""
    return robot_names(len(record.instance_data()["robots"]))


def image_key(camera: str) -> str:
    """Return the feature name of a camera's images."""
    return f"observation.images.{camera}"


def depth_key(camera: str) -> str:
    """Return the feature name of a camera's depth."""
    return f"observation.images.{camera}_depth"


def features(robots: tuple[str, ...], style: Style) -> dict[str, dict[str, Any]]:
    """Return the features of a frame in the notation of the format.

    Args:
        robots: Names of the robots.
        style: Options of the frames.

    Raises:
        UnknownNameError: The team has no such camera.
    """
    own, motors = list(MOTORS[style.control]), motor_names(style.control, robots)
    sides = (style.height_px, style.width_px)
    cameras = style.cameras_of(robots)
    found = {
        "observation.state": _feature("float32", (len(motors),), motors),
        "action": _feature("float32", (len(motors),), motors),
        **{
            f"{robot}.{part}": _feature("float32", (len(own),), own)
            for robot in robots
            for part in AGENT_PARTS
        },
        "next.reward": _feature("float32"),
        "next.done": _feature("bool"),
        "next.success": _feature("bool"),
        "subtask": _feature("string"),
        **{f"annotation.instruction.{kind}": _feature("string") for kind in KINDS},
    }
    if style.environment_state == SENTENCE:
        found[ENVIRONMENT_STATE] = _feature("float32", (NUMBERS,))
    elif style.environment_state == PRIVILEGED:
        names = truth_names(robots)
        found[ENVIRONMENT_STATE] = _feature("float32", (len(names),), names)
    axes = ["height", "width", "channels"]
    for camera in cameras:
        found[image_key(camera)] = _feature("video", (*sides, 3), axes)
    for camera in cameras if style.depth else ():
        depth = _feature("video", (*sides, 1), axes)
        found[depth_key(camera)] = {**depth, "info": {"is_depth_map": True}}
    return found


def _feature(
    dtype: str, shape: tuple[int, ...] = (1,), names: list[str] | None = None
) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "names": names}


def frames(
    record: EpisodeRecord,
    style: Style,
    kind: str = "high_level",
    change: Callable[[DenseStep], DenseStep] | None = None,
) -> Iterator[dict[str, Any]]:
    """Yield the frames of an episode, each with its ``task``.

    Args:
        record: The episode; its sub-tasks are executed again.
        style: Options of the frames.
        kind: Kind of the instruction that becomes the task.
        change: Changes the measured state of each step and its scene before it is
            seen; later steps are not affected.

    Raises:
        DatasetError: The replayed motion differs from the recorded one.
        RenderingError: OpenGL does not work here.
    """
    cameras = style.cameras_of(robots_of(record))
    task = getattr(record, kind)
    said = {f"annotation.instruction.{one}": getattr(record, one) for one in KINDS}
    tell = _teller(record, style, task)
    steps = iterate_steps(record, style.fps)
    if change is not None:
        steps = map(change, steps)
    for step, pictures in _filmed(steps, style, cameras):
        yield {
            **_numbers(record, step, style.control),
            **pictures,
            **said,
            **tell(step),
            "task": task,
        }


def _filmed(
    steps: Iterator[DenseStep], style: Style, cameras: tuple[str, ...]
) -> Iterator[tuple[DenseStep, dict[str, Any]]]:
    """Yield steps of an episode, each with its images by feature.

    A batch of states is rendered at a time, so memory does not grow with the length of
    an episode. The ``scene`` of a yielded step shows a later state.
    """
    if not cameras:
        yield from ((step, {}) for step in steps)
        return
    rig = style.rig()
    together = states_at_once(style.width_px, style.height_px, len(cameras))
    while chunk := [(s, s.scene.data.qpos.copy()) for s in islice(steps, together)]:
        states = np.array([qpos for _, qpos in chunk])
        seen = rig.film(chunk[0][0].scene, states, cameras, depth=style.depth)
        for number, (step, _) in enumerate(chunk):
            found = dict(zip(map(image_key, cameras), seen.rgb[number], strict=True))
            if seen.depth_m is not None:
                depths = seen.depth_m[number][..., None]
                found.update(zip(map(depth_key, cameras), depths, strict=True))
            yield step, found


def _teller(
    record: EpisodeRecord, style: Style, task: str
) -> Callable[[DenseStep], dict[str, Any]]:
    """Return a function from a step to its environment state."""
    if style.environment_state == SENTENCE:
        said = {ENVIRONMENT_STATE: sentence_vector(task)}
        return lambda step: said
    if style.environment_state == PRIVILEGED:
        instance = Instance.from_dict(record.instance_data())
        if kinds := TASKS[instance.task].kinds:
            raise InvalidConfigError(
                f"The true state has no numbers for {', '.join(kinds)}, which "
                f"{instance.task} has. Export it with another environment_state."
            )
        robots = tuple(range(len(robots_of(record))))
        observer = Observer(PRIVILEGED, robots, (_SMALLEST_PX, _SMALLEST_PX))

        def tell(step: DenseStep) -> dict[str, Any]:
            truth = observer.truth(step.objects, instance.scene, instance.goal)
            return {ENVIRONMENT_STATE: truth_vector(truth)}

        return tell
    return lambda step: {}


def _motors(step: DenseStep, control: str) -> tuple[Float32Array, Float32Array]:
    """Return state and action of a step, (robots, numbers)."""
    if control == JOINT_POSITION:
        state = np.column_stack([step.joints, step.opening_m])
        return state.astype(np.float32), step.action.astype(np.float32)
    bases = np.array([robot.world_from_base for robot in step.scene.robots])
    return (
        tool_rows(bases, step.tcp_poses, step.opening_m),
        tool_rows(bases, step.waypoints, step.action[:, -1]),
    )


def _numbers(record: EpisodeRecord, step: DenseStep, control: str) -> dict[str, Any]:
    state, action = _motors(step, control)
    agents = {
        f"{robot}.{part}": row
        for part, rows in zip(AGENT_PARTS, (state, action), strict=True)
        for robot, row in zip(robots_of(record), rows, strict=True)
    }
    last = len(record.subtasks)
    number = last if step.subtask == NO_SUBTASK else step.subtask
    is_success = step.is_done and record.success
    return {
        "observation.state": state.ravel(),
        "action": action.ravel(),
        **agents,
        "next.reward": np.array([step.reward], np.float32),
        "next.done": np.array([step.is_done]),
        "next.success": np.array([is_success]),
        "subtask": label(record, number)["sub_instruction"],
    }


def describe_episode(
    record: EpisodeRecord, style: Style, kind: str, length: int
) -> dict[str, Any]:
    """Return data that the format cannot store: origin, sentences, cameras.

    Args:
        record: The episode.
        style: Options of its frames.
        kind: Kind of the instruction that is the task.
        length: Number of frames.
    """
    return {
        "key": record.key,
        "task": record.task,
        "split": record.split,
        "index": record.index,
        "team": record.team,
        "distractors": record.distractors,
        "success": record.success,
        "length": length,
        "instruction": kind,
        "instructions": {kind: getattr(record, kind) for kind in KINDS},
        "subtasks": [row.instruction for row in record.subtasks],
        "cameras": _calibration(record, style) if style.images else {},
    }


def _calibration(record: EpisodeRecord, style: Style) -> dict[str, dict[str, Any]]:
    cameras = {}
    scene = Episode(Instance.from_dict(record.instance_data())).simulation.scene
    scene.refresh()
    rig = style.rig()
    for name in style.cameras_of(robots_of(record)):
        camera = rig.calibrated(scene, scene.data, name)
        lens = camera.intrinsics
        cameras[name] = {
            "intrinsics_px": [lens.fx, lens.fy, lens.cx, lens.cy],
            "world_from_camera": camera.world_from_camera.matrix().tolist(),
        }
    return cameras
