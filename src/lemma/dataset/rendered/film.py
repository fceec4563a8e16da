"""An episode as a film: every step with pictures, many states rendered at a time.

Only states that are rendered together are kept, so memory does not grow with the length
of an episode.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from lemma.core.arguments import known
from lemma.core.robot_names import robot_names
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.steps import DenseStep, iterate_steps, ticks_per_step
from lemma.env.camera_rig import CameraRig, camera_names
from lemma.scene.rendering.pictures import states_at_once


@dataclass(frozen=True, kw_only=True)
class Filming:
    """How episodes are filmed."""

    hz: int = 10
    """Frames per simulated second: a divisor of 100."""
    width: int = 128
    """Width of the pictures [px]."""
    height: int = 128
    """Height of the pictures [px]."""
    cameras: tuple[str, ...] = ()
    """Names of cameras, as an environment knows them; each robot's own if none."""
    depth: bool = False
    """Whether depth is filmed too."""
    renderer: str = "opengl"
    """A name in :data:`lemma.scene.rendering.batch.BATCH_RENDERERS`."""

    def __post_init__(self) -> None:
        """Check the rate and the size."""
        ticks_per_step(self.hz)
        states_at_once(self.width, self.height, 1)


@dataclass(frozen=True, slots=True)
class Frame:
    """A step, and its pictures."""

    step: DenseStep
    """The step. Its ``scene`` has gone on to a later one."""
    rgb: NDArray[np.uint8]
    """Color, shape (cameras, height, width, 3)."""
    depth_m: NDArray[np.float32] | None
    """Distance along each camera's z axis [m], shape (cameras, height, width)."""


def film(record: EpisodeRecord, how: Filming) -> Iterator[Frame]:
    """Yield the frames of an episode, from its first state to its end.

    Args:
        record: The episode; its sub-tasks are executed again.
        how: How to film it.

    Raises:
        DatasetError: The motion is not the recorded one.
        UnknownNameError: There is no such camera or renderer.
        RenderingError: The renderer does not work here.
    """
    cameras = cameras_of(robots_of(record), how.cameras)
    rig = rig_of(how.width, how.height, how.renderer)
    together = states_at_once(how.width, how.height, len(cameras))
    steps = iterate_steps(record, how.hz)
    while True:
        chunk, states = [], []
        for step in islice(steps, together):
            chunk.append(step)
            states.append(step.scene.data.qpos.copy())
        if not chunk:
            return
        seen = rig.film(chunk[0].scene, np.array(states), cameras, depth=how.depth)
        for number, step in enumerate(chunk):
            depth_m = None if seen.depth_m is None else seen.depth_m[number]
            yield Frame(step, seen.rgb[number], depth_m)


def cameras_of(
    robots: tuple[str, ...], chosen: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """Return names of the cameras that film a team: those chosen, or each robot's own.

    Raises:
        UnknownNameError: The team has no such camera.
    """
    valid = camera_names(robots)
    return tuple(known("camera", name, valid) for name in chosen or robots)


def robots_of(record: EpisodeRecord) -> tuple[str, ...]:
    """Return the names of an episode's robots."""
    return robot_names(len(record.instance_data()["robots"]))


@lru_cache(maxsize=1)
def rig_of(width: int, height: int, renderer: str) -> CameraRig:
    """Return the cameras of this process: starting them takes longer than a picture.

    Args:
        width: Width of the pictures [px].
        height: Height of the pictures [px].
        renderer: A name in :data:`lemma.scene.rendering.batch.BATCH_RENDERERS`.
    """
    return CameraRig(width, height, renderer)
