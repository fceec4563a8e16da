"""Thousands of tables at once: a Gymnasium vector environment of torch tensors."""

import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import warp as wp
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

from lemma.core.arguments import known
from lemma.env.control_env import SETTLE_S
from lemma.scene.build import TIME_STEP_S
from lemma.warp.draws import Draws
from lemma.warp.episodes import Episodes
from lemma.warp.graphs import recorded_if_possible
from lemma.warp.instances import make_pool
from lemma.warp.signals import Signals

CONTROLS = {"delta_hand": 5, "delta_joint": 7, "joint_position": 7}
"""Numbers of one robot by control mode."""
REWARDS = ("sparse", "dense", "level")
GRAPH_VARIABLE = "LEMMA_GPU_GRAPH"
"""Set to 0 in the environment, nothing beside the physics is a CUDA graph."""
_CHECK_STEPS = 64


class GpuVecEnv(Episodes, VectorEnv[Any, Any, Any]):
    """One task on many tables; see ``docs/gpu.md``."""

    def __init__(  # noqa: PLR0913
        self,
        task: str,
        num_envs: int = 4096,
        *,
        control: str = "delta_hand",
        team: tuple[str, ...] | None = None,
        reward: str = "dense",
        reward_discount: float = 0.99,
        control_hz: float = 10.0,
        horizon_s: float = 100.0,
        pool: int = 512,
        seed: int = 0,
        near: float = 0.0,
        device: str | None = None,
        graph: bool | None = None,
    ) -> None:
        """Sample instances, compile the model and capture the control step.

        Args:
            task: Name of a task with cubes and pads.
            num_envs: How many tables.
            control: A name in :data:`CONTROLS`.
            team: Arm types; the task's first team if None.
            reward: ``"sparse"``, ``"dense"``, or ``"level"``: (1 - discount) times the
                potential at every step, and 1 at success.
            reward_discount: The learner's discount.
            control_hz: Actions per second.
            horizon_s: Simulated seconds after which an episode is truncated.
            pool: How many instances are sampled.
            seed: Of the instances and draws.
            near: Share of episodes that begin with robot 0's hand near the goal's
                first object; may be changed at any time.
            device: ``"cuda:0"`` or ``"cpu"``; a GPU if there is one.
            graph: Whether what is beside the physics is replayed as CUDA graphs too;
                so on a GPU if None, unless :data:`GRAPH_VARIABLE` is 0.

        Raises:
            UnknownNameError: No such task, arm, control or reward.
            InvalidConfigError: The task is impossible here.
        """
        known("control", control, CONTROLS)
        known("reward", reward, REWARDS)
        self.device = _start_warp(device)
        self.control, self.reward = control, reward
        self.discount, self.num_envs = reward_discount, num_envs
        self.pool = make_pool(task, team, pool, seed)
        self._set_times(control_hz, horizon_s)
        # The instance; then five numbers for a start near the object.
        self.draws = Draws(num_envs, 6, seed, self.device)
        self._near, self._share = near, torch.full((), near, device=self.device)
        self._make_worlds()
        self.signals = Signals(self)
        self.numbers = len(self.robots) * CONTROLS[control]
        """Numbers of an action."""
        self._action = torch.zeros(num_envs, self.numbers, device=self.device)
        self.use_graph(
            os.environ.get(GRAPH_VARIABLE) != "0" if graph is None else graph
        )
        self._make_spaces()

    def _set_times(self, control_hz: float, horizon_s: float) -> None:
        self._steps = 0
        self._substeps = round(1.0 / (control_hz * TIME_STEP_S))
        self._settle = math.ceil(SETTLE_S * control_hz - 1e-6)
        self._horizon = max(1, round(horizon_s * control_hz))
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.lost_worlds = torch.zeros((), device=self.device)
        """How many worlds were reset because their state was no number any more."""

    @property
    def near(self) -> float:
        """Share of episodes that begin with robot 0's hand near the object."""
        return self._near

    @near.setter
    def near(self, share: float) -> None:
        begun = bool(self._near) != bool(share)
        self._near = share
        self._share.fill_(share)
        if begun and self.graphed:
            # What is recorded draws no such starts, or draws them in vain.
            kept = [memory.clone() for memory in self._mutable()]
            self._record()
            for memory, value in zip(self._mutable(), kept, strict=True):
                memory.copy_(value)

    def use_graph(self, on: bool) -> None:
        """Replay what is beside the physics as CUDA graphs, or not; begin anew.

        Where they cannot be recorded, a warning says why, and ``graphed`` stays false.
        """
        self._before: Callable[[], Any] = self._command
        self._after: Callable[[], Any] = self._judge
        first = self.draws.state.clone()
        self._start_all()
        if on and self.device.startswith("cuda"):
            self._record()
            self.draws.state.copy_(first)
            self._start_all()

    @property
    def graphed(self) -> bool:
        """Whether what is beside the physics is replayed as CUDA graphs."""
        return self._before != self._command and self._after != self._judge

    @torch.no_grad()
    def _record(self) -> None:
        work = {"the actions": self._command, "the judgement": self._judge}
        self._before, self._after = (
            recorded_if_possible(name, each, self.device) for name, each in work.items()
        )

    @torch.no_grad()
    def _start_all(self) -> None:
        """Set all tables, with the next draws."""
        self._begin(torch.ones_like(self._age, dtype=torch.bool))
        self.potential.copy_(self.signals.potential())

    def _make_spaces(self) -> None:
        self.single_action_space = Box(-1.0, 1.0, (self.numbers,))
        self.action_space = Box(-1.0, 1.0, (self.num_envs, self.numbers))
        shapes = {key: tuple(value.shape) for key, value in self._observe().items()}
        self.observation_space = Dict(
            {key: Box(-np.inf, np.inf, shape) for key, shape in shapes.items()}
        )
        self.single_observation_space = Dict(
            {key: Box(-np.inf, np.inf, shape[1:]) for key, shape in shapes.items()}
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Set all tables; a seed seeds which instances are drawn."""
        del options
        if seed is not None:
            self.draws.seed(seed)
        self._start_all()
        return self._observe(), {"instance": self.instance.clone()}

    def sentences(self) -> list[str]:
        """Return what is asked for on each table; copies numbers from the device."""
        found = self.pool.instances
        return [found[i].instructions["high_level"] for i in self.instance.tolist()]

    @torch.no_grad()
    def step(
        self, action: Tensor
    ) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Any]]:
        """Act on all tables.

        Args:
            action: (n, robots x numbers), clipped to [-1, 1] but for joint positions.

        Returns:
            Observations, rewards, terminated, truncated, and info: ``success`` and
            ``thrown`` of episodes that end, ``final_obs``, ``instance``.

        Raises:
            PhysicsError: A buffer of contacts or constraints was too small.
        """
        self._action.copy_(action)
        self._before()
        self._simulate()
        # A graph writes its results to the same memory at every replay.
        found = _copies(self._after())
        self._steps += 1
        if self._steps % _CHECK_STEPS == 0:
            self.check()
        told = ("observation", "reward", "terminated", "truncated")
        info = {key: value for key, value in found.items() if key not in told}
        observation, reward, terminated, truncated = (found[key] for key in told)
        return observation, reward, terminated, truncated, info


def _start_warp(device: str | None) -> str:
    # It would tell about every module that it loads, on the output.
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    return device or ("cuda:0" if torch.cuda.is_available() else "cpu")


def _graph_is_wanted() -> bool:
    return os.environ.get(GRAPH_VARIABLE) != "0"


def _copies(found: dict[str, Any]) -> dict[str, Any]:
    """Return tensors of their own, also in dictionaries."""
    return {
        key: _copies(value) if isinstance(value, dict) else value.clone()
        for key, value in found.items()
    }
