"""The interface of policies at control level: camera images in, motor commands out.

The input is the observation of :class:`ControlEnv`, with the options that the policy
asks for, and the cameras' calibration. The answer is one action or a chunk of them, and
anything that the policy wants to remember of the episode.
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
    "decides by motor commands: it has control_options. Say --level control, or "
    'level="control" in Python.'
)
"""Error message for such a policy at another level."""


def has_options(policy: object) -> bool:
    """Whether a policy says in which environment it acts; see ControlPolicy."""
    return bool(getattr(policy, "control_options", None))


def is_model_server(name: str) -> bool:
    """Whether a policy's name is the address of a model server of vla-eval."""
    return name.lower().startswith(f"{MODEL_SERVER}://")


@dataclass(frozen=True, eq=False, kw_only=True)
class ControlInput:
    """All that a policy may know of an episode when it is asked for actions."""

    instruction: str
    robots: tuple[str, ...]
    """How people name the robots, in the order of an action's rows."""
    observation: Mapping[str, Any]
    """Observation of :class:`~lemma.env.control_env.ControlEnv` with the policy's
    options: ``agent_pos`` and more, ``pixels`` and ``depth`` by camera. Copies."""
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    """Intrinsics and extrinsics of the cameras in ``observation``, by name."""
    step: int = 0
    """Control steps since the episode began."""
    time_s: float = 0.0
    """Simulated time since then [s]."""
    memory: Any = None
    """The policy's last memory of this episode; None at the beginning."""


@dataclass(frozen=True, eq=False)
class Actions:
    """Answer of a policy for one episode."""

    rows: ArrayLike
    """One action, (robots, numbers), or a chunk of them, (steps, robots, numbers), all
    of which are carried out before the policy is asked again."""
    memory: Any = None
    """Comes back as ``memory`` of the next input of the same episode."""


@runtime_checkable
class ControlPolicy(Protocol):
    """Decides on motor commands.

    An attribute ``control_options``, a dictionary, says in which environment it acts,
    see :data:`CONTROL_OPTIONS`. Without it: joint positions at 20 Hz, RGB of the
    cameras that environments of this level observe.
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
    """Return the actions of an answer, oldest first.

    Args:
        rows: One action of a shape, or several.
        shape: (robots, numbers).

    Raises:
        ValueError: It is neither.
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
