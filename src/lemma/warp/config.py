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
"""Number of action dimensions of one robot by control mode."""
OBSERVATIONS = ("state", "rgbd")
"""Observations; ``"rgbd"`` adds ``pixels`` and ``depth`` for each camera."""
REWARDS = ("sparse", "dense", "level", "rise")
GRAPH_VARIABLE = "LEMMA_GPU_GRAPH"
"""Environment variable; 0 disables the CUDA graphs of everything except the physics."""


@dataclass(frozen=True)
class GpuConfig:
    """Instances, actions, observations, rewards and the device of an environment."""

    control: str = "delta_hand"
    """A name in :data:`CONTROLS`."""
    team: tuple[str, ...] | None = None
    """Arm types; the task's first team if None."""
    reward: str = "dense"
    """``"sparse"``; ``"dense"``; ``"level"``: (1 - discount) times the potential at
    every step, and 1 at success; or ``"rise"``: the increase of the potential, 0 if an
    object is thrown, and 1 at success."""
    reward_discount: float = 0.99
    """The learner's discount factor."""
    control_hz: float = 10.0
    """Actions per simulated second."""
    horizon_s: float = 100.0
    """Simulated seconds after which an episode is truncated."""
    pool: int = 512
    """Number of sampled instances."""
    seed: int = 0
    """Seed of the instances and of random numbers."""
    near: float = 0.0
    """Share of episodes that begin with a hand over the goal's first object, around it
    or closed on it."""
    observation: str = "state"
    """A name in :data:`OBSERVATIONS`."""
    cameras: tuple[str, ...] | None = None
    """Cameras of ``"rgbd"``, see :class:`~lemma.warp.pictures.Pictures`; if None, those
    above the reach of each robot."""
    width: int = 128
    """Width of images [px]."""
    height: int = 128
    """Height of images [px]."""
    device: str | None = None
    """``"cuda:0"`` or ``"cpu"``; if None, a GPU if there is one."""
    graph: bool | None = None
    """Whether CUDA graphs replay everything besides the physics, too; if None, on a GPU
    unless :data:`GRAPH_VARIABLE` is 0."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            UnknownNameError: There is no such control, reward or observation.
            InvalidConfigError: A number is out of range.
        """
        known("control", self.control, CONTROLS)
        known("reward", self.reward, REWARDS)
        known("observation", self.observation, OBSERVATIONS)
        least = min(self.pool, self.width, self.height)
        if least < 1 or not 0.0 <= self.near <= 1.0:
            raise InvalidConfigError(
                f"pool={self.pool}, width={self.width} and height={self.height} must "
                f"be at least 1, and near={self.near} must be in [0, 1]."
            )

    @classmethod
    def from_options(cls, options: dict[str, Any]) -> Self:
        """Make a configuration from keyword arguments.

        Raises:
            UnknownNameError: There is no such option, or no such value of it.
            InvalidConfigError: A number is out of range.
        """
        valid = [field.name for field in fields(cls)]
        for name in options:
            if name not in valid:
                raise UnknownNameError("option", name, valid)
        return cls(**options)

    @property
    def chosen_device(self) -> str:
        """The device of the environment."""
        found = "cuda:0" if torch.cuda.is_available() else "cpu"
        return self.device or found

    @property
    def uses_graph(self) -> bool:
        """Whether to use CUDA graphs."""
        asked = os.environ.get(GRAPH_VARIABLE) != "0"
        return asked if self.graph is None else self.graph
