"""Wrappers of :class:`GpuVecEnv` for libraries of reinforcement learning.

:class:`RobotsEnv` has a dictionary of tensors per robot for multi-agent learners of
skrl (``wrap_env(env, "isaaclab-multi-agent")``); :class:`RunnerEnv` is a vector
environment of rsl_rl. Both have the same observation of each robot, :func:`rows_of`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor

from lemma.warp.vector_env import GpuVecEnv

KEYS = ("agent_pos", "agent_vel", "goal_state", "target", "here", "base", "asked")
"""Parts of an observation with numbers per robot, in the order of :func:`rows_of`."""


def rows_of(observation: Mapping[str, Tensor], robots: int) -> Tensor:
    """Return the observation of each robot, (n, robots, numbers).

    Args:
        observation: Observation of a :class:`GpuVecEnv`.
        robots: Number of robots.
    """
    n = len(observation["here"])
    return torch.cat([observation[key].view(n, robots, -1) for key in KEYS], -1)


class RobotsEnv:
    """A multi-agent environment with one agent per robot: tensors by robots' names.

    All robots get the team's reward, and their episodes end together. The state for a
    central critic is the concatenation of all observations.
    """

    def __init__(self, env: GpuVecEnv) -> None:
        """Wrap an environment."""
        self.env = env
        self.agents = [robot.name for robot in env.robots]
        self.possible_agents = list(self.agents)
        self.num_agents = self.max_num_agents = len(self.agents)
        self.num_envs, self.device = env.num_envs, torch.device(env.device)
        self._rows = self._show(env.reset()[0])
        numbers = self._rows.shape[-1]
        actions = env.numbers // self.num_agents
        self.observation_spaces = {
            name: Box(-np.inf, np.inf, (numbers,)) for name in self.agents
        }
        self.action_spaces = {name: Box(-1.0, 1.0, (actions,)) for name in self.agents}
        self.state_space = Box(-np.inf, np.inf, (self.num_agents * numbers,))

    @property
    def unwrapped(self) -> "RobotsEnv":
        """This environment."""
        return self

    def _show(self, observation: Mapping[str, Tensor]) -> Tensor:
        return rows_of(observation, self.num_agents)

    def _dict(self, rows: Tensor) -> dict[str, Tensor]:
        return {name: rows[:, k] for k, name in enumerate(self.agents)}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Reset all worlds; return observations by robot, and info."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._rows = self._show(observation)
        return self._dict(self._rows), info

    def step(
        self, actions: Mapping[str, Tensor]
    ) -> tuple[
        dict[str, Tensor],
        dict[str, Tensor],
        dict[str, Tensor],
        dict[str, Tensor],
        dict[str, Any],
    ]:
        """Act in all worlds; each action is (n, numbers of one robot).

        Returns:
            Observations, rewards, terminated and truncated, (n,) each, by robot; and
            info.
        """
        together = torch.cat([actions[name] for name in self.agents], -1)
        observation, reward, terminated, truncated, info = self.env.step(together)
        self._rows = self._show(observation)

        def each(value: Tensor) -> dict[str, Tensor]:
            return dict.fromkeys(self.agents, value)

        shown = self._dict(self._rows)
        return shown, each(reward), each(terminated), each(truncated), info

    def state(self) -> Tensor:
        """Return the last observations of all robots, (n, robots x numbers)."""
        return self._rows.flatten(1)

    def close(self) -> None:
        """Do nothing; part of skrl's interface."""


class RunnerEnv:
    """An environment for ``rsl_rl.runners.OnPolicyRunner``; all robots are one agent.

    It needs the package ``tensordict``, a dependency of rsl_rl.
    """

    def __init__(self, env: GpuVecEnv) -> None:
        """Wrap an environment."""
        self.env = env
        self.num_envs, self.num_actions = env.num_envs, env.numbers
        self.max_episode_length, self.device = env._horizon, env.device
        self.cfg = vars(env.config)
        self._shown = self._group(env.reset()[0])

    def _group(self, observation: Mapping[str, Tensor]) -> Any:
        from tensordict import TensorDict  # noqa: PLC0415

        rows = rows_of(observation, len(self.env.robots)).flatten(1)
        return TensorDict({"policy": rows}, batch_size=[self.num_envs])

    @property
    def episode_length_buf(self) -> Tensor:
        """Steps of the episodes so far, (n,)."""
        return self.env._age

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:
        self.env._age.copy_(steps)

    def get_observations(self) -> Any:
        """Return the present observations, a TensorDict with the group ``policy``."""
        return self._shown

    def step(self, actions: Tensor) -> tuple[Any, Tensor, Tensor, dict[str, Any]]:
        """Act in all worlds.

        Args:
            actions: (n, robots x numbers).

        Returns:
            Observations, rewards (n,), whether episodes ended (n,), and extras:
            ``time_outs``, and for the log the share of successes among the ends.
        """
        observation, reward, terminated, truncated, info = self.env.step(actions)
        self._shown = self._group(observation)
        done = terminated | truncated
        share = info["success"].sum() / done.sum().clamp_min(1)
        extras = {"time_outs": truncated, "log": {"/success": share}}
        return self._shown, reward, done.long(), extras
