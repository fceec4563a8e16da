"""Options of a :class:`~lemma.warp.vector_env.GpuVecEnv`."""

import os
from dataclasses import dataclass, fields
from typing import Any, Self

import torch

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError, UnknownNameError

CONTROLS = {
    "delta_hand": 5,
    "delta_ee_pose": 7,
    "delta_joint": 7,
    "joint_position": 7,
}
"""Numbers of one robot by control mode."""
OBSERVATIONS = ("state", "rgbd")
"""``"rgbd"`` adds ``pixels`` and ``depth``, for each camera."""
REWARDS = ("sparse", "dense", "level", "rise")
GRAPH_VARIABLE = "LEMMA_GPU_GRAPH"
"""Set to 0 in the environment, nothing beside the physics is a CUDA graph."""


@dataclass(frozen=True)
class GpuConfig:
    """Tables, actions, observations, rewards and the device of an environment."""

    control: str = "delta_hand"
    """A name in :data:`CONTROLS`."""
    team: tuple[str, ...] | None = None
    """Arm types; the task's first team if None."""
    reward: str = "dense"
    """``"sparse"``, ``"dense"``, or ``"level"``: (1 - discount) times the potential at
    every step, and 1 at success; or ``"rise"``: what the potential rises by, nothing
    where something is thrown, and 1 at success."""
    reward_discount: float = 0.99
    """The learner's discount."""
    control_hz: float = 10.0
    """Actions per simulated second."""
    horizon_s: float = 100.0
    """Simulated seconds after which an episode is truncated."""
    pool: int = 512
    """How many instances are sampled."""
    seed: int = 0
    """Of the instances and draws."""
    near: float = 0.0
    """Share of episodes that begin with a hand over the goal's first object, around it
    or closed on it."""
    observation: str = "state"
    """A name in :data:`OBSERVATIONS`."""
    cameras: tuple[str, ...] | None = None
    """Cameras of ``"rgbd"``, see :class:`~lemma.warp.pictures.Pictures`; those above
    where each robot reaches if None."""
    width: int = 128
    """Of pictures [px]."""
    height: int = 128
    """Of pictures [px]."""
    device: str | None = None
    """``"cuda:0"`` or ``"cpu"``; a GPU if None and there is one."""
    graph: bool | None = None
    """Whether what is beside the physics is replayed as CUDA graphs too; so on a GPU if
    None, unless :data:`GRAPH_VARIABLE` is 0."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            UnknownNameError: No such control, reward or observation.
            InvalidConfigError: A number is impossible.
        """
        known("control", self.control, CONTROLS)
        known("reward", self.reward, REWARDS)
        known("observation", self.observation, OBSERVATIONS)
        least = min(self.pool, self.width, self.height)
        if least < 1 or not 0.0 <= self.near <= 1.0:
            raise InvalidConfigError(
                f"pool={self.pool}, width={self.width} and height={self.height} are "
                f"from 1 up, and near={self.near} is a share."
            )

    @classmethod
    def from_options(cls, options: dict[str, Any]) -> Self:
        """Make a configuration from keyword arguments.

        Raises:
            UnknownNameError: There is no such option, or no such value of it.
            InvalidConfigError: A number is impossible.
        """
        valid = [field.name for field in fields(cls)]
        for name in options:
            if name not in valid:
                raise UnknownNameError("option", name, valid)
        return cls(**options)

    @property
    def chosen_device(self) -> str:
        """The device that is used here."""
        found = "cuda:0" if torch.cuda.is_available() else "cpu"
        return self.device or found

    @property
    def uses_graph(self) -> bool:
        """Whether CUDA graphs are asked for."""
        asked = os.environ.get(GRAPH_VARIABLE) != "0"
        return asked if self.graph is None else self.graph
