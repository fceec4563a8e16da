"""Control-level environments with flat observations and one action vector."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike, NDArray

from lemma.core.errors import InvalidActionError, InvalidConfigError, shown
from lemma.env.control_env import ControlEnv
from lemma.env.observation import (
    POSE_AXES,
    TRUTH,
    Observation,
    truth_vector,
)
from lemma.robots.ur.build import JOINTS

STATES = ("agent_pos", "agent_vel", "tcp_pose", "base_pose")
"""Parts that a state may have."""


class FlatView(
    gymnasium.Wrapper[dict[str, NDArray[Any]], Any, Observation, Any],
    RecordConstructorArgs,
):
    """Flat names of observations and one action vector for a :class:`ControlEnv`.

    The observation is a dictionary of arrays with the names of LeRobot:

    - ``observation.state``, (n,) float32: the parts of the state, concatenated, each
      for all robots. By default ``agent_pos``, the 14 numbers of our data sets.
    - ``observation.images.NAME``, (height, width, 3) uint8: each camera's image.
    - ``observation.depth.NAME``, (height, width) float32 [m]: each camera's depth.
    - ``observation.environment_state``, (m,) float32: the concatenated true state or
      the goal state, with the option ``observation="privileged"`` or ``"goal_state"``.

    The instruction is in ``info["instruction"]`` and ``task_description``; the top-down
    map is only in the wrapped environment. The action is one vector: the rows of the
    environment's ``action_layout``, concatenated. :attr:`action_names` and
    :attr:`state_names` name every number. Values are unchanged.
    """

    def __init__(
        self,
        env: gymnasium.Env[Observation, Any],
        state: Sequence[str] = ("agent_pos",),
    ) -> None:
        """Define the flat spaces.

        Args:
            env: An environment at control level, with or without wrappers around it.
            state: Parts of the state, some of :data:`STATES`.

        Raises:
            InvalidConfigError: The environment is not at control level, or there is no
                such part.
        """
        RecordConstructorArgs.__init__(self, state=state)
        gymnasium.Wrapper.__init__(self, env)
        inner = env.unwrapped
        if not isinstance(inner, ControlEnv):
            raise InvalidConfigError(
                f"{shown(inner)} has no vector of numbers as action. Make the "
                'environment with level="control".'
            )
        if isinstance(state, str) or not state or not set(state) <= set(STATES):
            raise InvalidConfigError(
                f"state={shown(state)} is impossible. Valid: one or more of "
                f"{', '.join(STATES)}, as a tuple."
            )
        self._state = tuple(state)
        self.layout = inner.action_layout
        self.action_names = tuple(
            f"{row}.{column}"
            for row in self.layout.rows
            for column in self.layout.columns
        )
        """Name of each number of an action: ``robot_0.dx``."""
        self.state_names = _state_names(inner.robot_names, self._state)
        """Name of each number of the state: ``robot_0.gripper``."""
        box = self.layout.box()
        self.action_space = spaces.Box(
            box.low.reshape(-1), box.high.reshape(-1), dtype=np.float32
        )
        assert isinstance(env.observation_space, spaces.Dict)
        flat = self._flat_space(env.observation_space)
        self.observation_space = flat  # type: ignore[assignment]
        self._keys = tuple(flat.spaces)

    def _flat_space(self, space: spaces.Dict) -> spaces.Dict:
        found: dict[str, spaces.Space[Any]] = {
            "observation.state": _joined([space[name] for name in self._state])
        }
        for kind, prefix in (("pixels", "images"), ("depth", "depth")):
            if kind in space.spaces:
                images = space[kind]
                assert isinstance(images, spaces.Dict)
                for name, image in images.items():
                    found[f"observation.{prefix}.{name}"] = image
        if "objects" in space.spaces:
            found["observation.environment_state"] = _joined(
                [space[name] for name in TRUTH]
            )
        if "goal_state" in space.spaces:
            found["observation.environment_state"] = space["goal_state"]
        return spaces.Dict(found)

    def flatten(self, observation: Observation) -> dict[str, NDArray[Any]]:
        """Return an observation of the environment under its flat names."""
        found: dict[str, NDArray[Any]] = {}
        for key in self._keys:
            kind, _, name = key.removeprefix("observation.").partition(".")
            if kind == "images":
                found[key] = observation["pixels"][name]
            elif kind == "depth":
                found[key] = observation["depth"][name]
            elif kind == "state":
                rows = [np.ravel(observation[part]) for part in self._state]
                found[key] = np.concatenate(rows).astype(np.float32)
            elif "goal_state" in observation:
                found[key] = observation["goal_state"]
            else:
                found[key] = truth_vector(observation)
        return found

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start a new episode; see :meth:`LemmaEnv.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self.flatten(observation), info

    def step(
        self, action: ArrayLike
    ) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Command the motors for one control step.

        Args:
            action: All numbers in one row; see :attr:`action_names`.

        Raises:
            InvalidActionError: The action has another shape, or is out of bounds.
            ResetNeededError: The episode is over.
        """
        count = len(self.action_names)
        try:
            row = np.asarray(action)
        except (TypeError, ValueError, RuntimeError, OverflowError):
            row = np.empty(0)
        if row.shape != (count,):
            raise InvalidActionError(
                f"The action {shown(action)} is no row of {count} numbers. Valid: "
                f"shape ({count},), with {', '.join(self.action_names)}."
            )
        rows = row.reshape(self.layout.shape)
        observation, reward, terminated, truncated, info = self.env.step(rows)
        return self.flatten(observation), float(reward), terminated, truncated, info


def _joined(parts: Sequence[spaces.Space[Any]]) -> spaces.Box:
    """Return the space of the concatenated arrays of some spaces."""
    lows, highs = [], []
    for part in parts:
        if isinstance(part, spaces.Box):
            low, high = part.low.reshape(-1), part.high.reshape(-1)
        else:
            # Boolean values.
            low = np.zeros(int(np.prod(part.shape or (1,))))
            high = low + 1.0
        lows.append(low)
        highs.append(high)
    return spaces.Box(
        np.concatenate(lows).astype(np.float32),
        np.concatenate(highs).astype(np.float32),
        dtype=np.float32,
    )


def _state_names(robots: Sequence[str], parts: Sequence[str]) -> tuple[str, ...]:
    # The names of data sets.
    motors = (*JOINTS, "gripper")
    numbers = {
        "agent_pos": motors,
        "agent_vel": [f"{motor}_rate" for motor in motors],
        "tcp_pose": [f"tcp_{axis}" for axis in POSE_AXES],
        "base_pose": [f"base_{axis}" for axis in POSE_AXES],
    }
    return tuple(
        f"{robot}.{number}"
        for part in parts
        for robot in robots
        for number in numbers[part]
    )
