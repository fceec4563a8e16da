"""Pictures of many states of a scene, and which cameras take them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError
from lemma.scene.cameras import Camera

_MOST_STATES = 64
_MOST_PIXELS = 2**22

Aim = Callable[[mujoco.MjData], Sequence[str | Camera]]
"""Returns the cameras that look at a state with derived poses up to date: names in the
scene, or calibrated cameras, which may move from state to state."""


class Pictures(NamedTuple):
    """Pictures of some cameras in some states."""

    rgb: NDArray[np.uint8]
    """Color, shape (states, cameras, height, width, 3)."""
    depth_m: NDArray[np.float32] | None
    """Distance along the camera's z axis [m], shape (states, cameras, height, width);
    0: nothing. None if it was not asked for."""


def states_at_once(width: int, height: int, cameras: int) -> int:
    """Return how many states to render together: memory is bounded by pixels.

    Args:
        width: Of every picture [px].
        height: Of every picture [px].
        cameras: How many look at each state.

    Raises:
        InvalidConfigError: There is nothing to render.
    """
    if min(width, height, cameras) < 1:
        raise InvalidConfigError(
            f"{cameras} cameras of {width} x {height} pixels see nothing. All three "
            "must be at least 1."
        )
    return max(1, min(_MOST_STATES, _MOST_PIXELS // (width * height * cameras)))
