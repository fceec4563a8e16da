"""The interface of policies at control level: camera images in, motor commands out.

The input is the observation of :class:`ControlEnv`, with the options of the policy, and
the cameras' calibration. The output is an action or a chunk of actions, and any memory
that the policy needs later in the episode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from lemma.scene.cameras import Camera

CONTROL_OPTIONS = (
    *("control", "control_hz", "clip_actions", "delta_position_m"),
    *("delta_rotation_rad", "observation", "width", "height", "cameras"),
)
"""Options of :class:`~lemma.env.config.EnvConfig` that a policy chooses."""
MODEL_SERVER = "vla-eval"
"""Scheme of the address of a model server of vla-eval, before ``://``."""


IS_CONTROL = (
    "returns motor commands: it has control_options. Add --level control, or "
    'level="control" in Python.'
)
"""Error message for such a policy at another level."""


def has_options(policy: object) -> bool:
    """Return whether a policy has ``control_options``; see :class:`ControlPolicy`."""
    return bool(getattr(policy, "control_options", None))


def is_model_server(name: str) -> bool:
    """Return whether a policy's name is the address of a vla-eval model server."""
    return name.lower().startswith(f"{MODEL_SERVER}://")


@dataclass(frozen=True, eq=False, kw_only=True)
class ControlInput:
    """All inputs of a policy's decision at control level."""

    instruction: str
    robots: tuple[str, ...]
    """Names of the robots in instructions, in the order of an action's rows."""
    observation: Mapping[str, Any]
    """Observation of :class:`~lemma.env.control_env.ControlEnv` with the policy's
    options: ``agent_pos`` and more, ``pixels`` and ``depth`` by camera. Copies."""
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    """Intrinsics and extrinsics of the cameras in ``observation``, by name."""
    step: int = 0
    """Control steps since the episode began."""
    time_s: float = 0.0
    """Simulated time since the episode began [s]."""
    memory: Any = None
    """The policy's last memory of this episode; None at the beginning."""


@dataclass(frozen=True, eq=False)
class Actions:
    """Output of a policy for one episode."""

    rows: ArrayLike
    """One action, (robots, numbers), or a chunk, (steps, robots, numbers), which is
    executed completely before the next call."""
    memory: Any = None
    """Passed back as ``memory`` of the next input of the same episode."""


@runtime_checkable
class ControlPolicy(Protocol):
    """Decides on motor commands.

    The attribute ``control_options``, a dictionary, sets the options of its
    environment, see :data:`CONTROL_OPTIONS`. The default is joint positions at 20 Hz,
    and RGB images of the cameras that environments of this level observe.
    """

    def act(
        self, inputs: Sequence[ControlInput]
    ) -> Sequence[Actions | ArrayLike]:  # pragma: no cover - a protocol
        """Return the next action or chunk of actions for each episode.

        Args:
            inputs: One per episode; at least one.
        """
        ...


def chunk_of(rows: ArrayLike, shape: tuple[int, int]) -> list[Any]:
    """Return the actions of a policy's output, oldest first.

    Args:
        rows: One action of the shape, or a chunk.
        shape: (robots, numbers).

    Raises:
        ValueError: The shape is neither.
    """
    values = np.asarray(rows)
    if values.shape == shape:
        return [values]
    if values.ndim != 3 or values.shape[1:] != shape or not len(values):
        raise ValueError(
            f"The actions have shape {values.shape}. Valid: {shape}, or (steps, "
            f"{shape[0]}, {shape[1]}) for a chunk"
        )
    return list(values)
