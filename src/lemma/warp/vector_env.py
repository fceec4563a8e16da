"""A Gymnasium vector environment of thousands of worlds, with torch tensors."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import warp as wp
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

from lemma.env.control_env import SETTLE_S
from lemma.scene.build import TIME_STEP_S
from lemma.warp.config import CONTROLS, GpuConfig
from lemma.warp.draws import Draws
from lemma.warp.episodes import Episodes
from lemma.warp.graphs import recorded_if_possible
from lemma.warp.instances import make_pool
from lemma.warp.pictures import Pictures
from lemma.warp.signals import Signals

_CHECK_STEPS = 64


class GpuVecEnv(Episodes, VectorEnv[Any, Any, Any]):
    """One task in many worlds; see ``docs/gpu.md``."""

    def __init__(self, task: str, num_envs: int = 4096, **options: Any) -> None:
        """Sample instances, compile the model and capture the control step.

        Args:
            task: Name of a task with cubes and pads.
            num_envs: Number of worlds.
            **options: Fields of :class:`~lemma.warp.config.GpuConfig`.

        Raises:
            UnknownNameError: There is no such task, arm or option, or value of an
                option.
            InvalidConfigError: An option is invalid, or the task is not supported.
        """
        self.config = config = GpuConfig.from_options(options)
        # By default Warp prints a line for every module that it loads.
        wp.config.log_level = wp.LOG_WARNING
        wp.init()
        self.device, self.num_envs = config.chosen_device, num_envs
        self.control, self.reward = config.control, config.reward
        self.discount = config.reward_discount
        self.pool = make_pool(task, config.team, config.pool, config.seed)
        self._set_times(config.control_hz, config.horizon_s)
        # One number for the instance, and six for a start near the object.
        self.draws = Draws(num_envs, 7, config.seed, self.device)
        self._near = config.near
        self._share = torch.full((), config.near, device=self.device)
        self._make_worlds()
        self.signals = Signals(self)
        self.numbers = len(self.robots) * CONTROLS[self.control]
        """Number of dimensions of an action."""
        self._action = torch.zeros(num_envs, self.numbers, device=self.device)
        self._make_texts()
        self.use_graph(config.uses_graph)
        self.pictures = None
        if config.observation == "rgbd":
            names = config.cameras or [f"{r.name}_reach" for r in self.robots]
            self.pictures = Pictures(self, names, config.width, config.height)
        self._make_spaces()

    def _set_times(self, control_hz: float, horizon_s: float) -> None:
        self._steps = 0
        self._substeps = round(1.0 / (control_hz * TIME_STEP_S))
        self._settle = math.ceil(SETTLE_S * control_hz - 1e-6)
        self._horizon = max(1, round(horizon_s * control_hz))
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.lost_worlds = torch.zeros((), device=self.device)
        """Number of worlds that were reset because their state was not finite."""

    @property
    def near(self) -> float:
        """Share of episodes that begin with a hand near the object."""
        return self._near

    @near.setter
    def near(self, share: float) -> None:
        begun = bool(self._near) != bool(share)
        self._near = share
        self._share.fill_(share)
        if begun and self.graphed:
            # The graph depends on whether there are such starts, so record it anew.
            kept = [memory.clone() for memory in self._mutable()]
            self._record()
            for memory, value in zip(self._mutable(), kept, strict=True):
                memory.copy_(value)

    def use_graph(self, on: bool) -> None:
        """Switch the CUDA graphs besides the physics on or off, and reset all worlds.

        If they cannot be recorded, there is a warning, and ``graphed`` stays False.
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
        """Whether CUDA graphs replay everything besides the physics, too."""
        return self._before != self._command and self._after != self._judge

    @torch.no_grad()
    def _record(self) -> None:
        work = {"the actions": self._command, "the judgement": self._judge}
        self._before, self._after = (
            recorded_if_possible(name, each, self.device) for name, each in work.items()
        )

    @torch.no_grad()
    def _start_all(self) -> None:
        """Reset all worlds, with the next random numbers."""
        self._begin(torch.ones_like(self._age, dtype=torch.bool))
        self.potential.copy_(self.signals.potential())

    def _seen(self, found: dict[str, Any]) -> dict[str, Any]:
        """Return an observation with images, if the options have them."""
        return found | self.pictures.look() if self.pictures else found

    def _make_texts(self) -> None:
        sentences = [one.instructions["high_level"] for one in self.pool.instances]
        self._texts = tuple(dict.fromkeys(sentences))
        places = [self._texts.index(text) for text in sentences]
        self._sentence = torch.tensor(places, device=self.device)

    def _sentence_numbers(self) -> Tensor:
        return self._sentence[self.instance]

    def _make_spaces(self) -> None:
        self.single_action_space = Box(-1.0, 1.0, (self.numbers,))
        self.action_space = Box(-1.0, 1.0, (self.num_envs, self.numbers))
        found = self._seen(self._observe())
        self.observation_space = _space(found)
        self.single_observation_space = _space(found, 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Reset all worlds; a seed determines the drawn instances."""
        del options
        if seed is not None:
            self.draws.seed(seed)
        self._start_all()
        info = {"instance": self.instance.clone(), "sentence": self._sentence_numbers()}
        return self._seen(self._observe()), info

    @property
    def texts(self) -> tuple[str, ...]:
        """All instructions of the pool; ``info["sentence"]`` has indices into it."""
        return self._texts

    def sentences(self) -> list[str]:
        """Return the instruction of each world; copies numbers from the device."""
        return [self._texts[i] for i in self._sentence[self.instance].tolist()]

    @torch.no_grad()
    def step(
        self, action: Tensor
    ) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Any]]:
        """Act in all worlds.

        Args:
            action: (n, robots x numbers), clipped to [-1, 1] except joint positions.

        Returns:
            Observations, rewards, terminated, truncated, and info: ``success`` and
            ``thrown`` of episodes that end, ``final_obs``, and the indices of the
            ``instance`` and of its ``sentence`` in :attr:`texts`.

        Raises:
            PhysicsError: A buffer of contacts or constraints is too small.
        """
        self._action.copy_(action)
        self._before()
        self._simulate()
        # Copy, because every replay of a graph overwrites its results.
        found = _copies(self._after())
        self._steps += 1
        if self._steps % _CHECK_STEPS == 0:
            self.check()
        returned = ("observation", "reward", "terminated", "truncated")
        info = {key: value for key, value in found.items() if key not in returned}
        info["sentence"] = self._sentence_numbers()
        observation, reward, terminated, truncated = (found[key] for key in returned)
        return self._seen(observation), reward, terminated, truncated, info


def _space(found: dict[str, Any], first: int = 0) -> Dict:
    """Return the space of observations, without the first ``first`` axes."""
    spaces: dict[str, Space[Any]] = {}
    for key, value in found.items():
        if isinstance(value, dict):
            spaces[key] = _space(value, first)
        elif value.dtype == torch.uint8:
            spaces[key] = Box(0, 255, tuple(value.shape)[first:], np.uint8)
        else:
            spaces[key] = Box(-np.inf, np.inf, tuple(value.shape)[first:])
    return Dict(spaces)


def _copies(found: dict[str, Any]) -> dict[str, Any]:
    """Return copies of tensors, also in nested dictionaries."""
    return {
        key: _copies(value) if isinstance(value, dict) else value.clone()
        for key, value in found.items()
    }
