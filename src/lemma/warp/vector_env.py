"""Thousands of tables at once: a Gymnasium vector environment of torch tensors."""

import math
from typing import Any

import numpy as np
import torch
import warp as wp
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

from lemma.core.errors import InvalidConfigError
from lemma.env.control_env import SETTLE_S
from lemma.policies.control.hand_steps import Arms, advance, joints, openings
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.build import TIME_STEP_S
from lemma.warp.instances import make_pool
from lemma.warp.signals import Signals
from lemma.warp.worlds import Worlds

CONTROLS = {"delta_hand": 5, "delta_joint": 7, "joint_position": 7}
"""Numbers of one robot by control mode."""
REWARDS = ("sparse", "dense", "level")
JOINT_STEP_RAD = 0.1
"""A 1 in ``delta_joint``."""
_CHECK_STEPS = 64


class GpuVecEnv(Worlds, VectorEnv[Any, Any, Any]):
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

        Raises:
            UnknownNameError: No such task or arm.
            InvalidConfigError: An option is impossible, or the task is.
        """
        if control not in CONTROLS or reward not in REWARDS:
            raise InvalidConfigError(
                f"control={control!r}, reward={reward!r}. Valid: "
                f"{', '.join(CONTROLS)}; {', '.join(REWARDS)}."
            )
        wp.config.quiet = True
        wp.init()
        self.device = device or ("cuda:0" if torch.cuda.is_available() else "cpu")
        self.control, self.reward, self.near = control, reward, near
        self.discount, self.num_envs = reward_discount, num_envs
        self.pool = make_pool(task, team, pool, seed)
        self._set_times(seed, control_hz, horizon_s)
        self._steps = 0
        self._make_physics()
        self._make_memory()
        self._make_constants()
        self.signals = Signals(self)
        self.numbers = len(self.robots) * CONTROLS[control]
        """Numbers of an action."""
        self._capture()
        self._begin(torch.ones(num_envs, dtype=torch.bool, device=self.device))
        self._make_spaces()

    def _set_times(self, seed: int, control_hz: float, horizon_s: float) -> None:
        self._torch = torch.Generator(self.device).manual_seed(seed)
        self._substeps = round(1.0 / (control_hz * TIME_STEP_S))
        self._settle = math.ceil(SETTLE_S * control_hz - 1e-6)
        self._horizon = max(1, round(horizon_s * control_hz))
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.lost_worlds = torch.zeros((), device=self.device)
        """How many worlds were reset because their state was no number any more."""

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

    def _begin(self, fresh: Tensor) -> None:
        """Set the tables of some worlds, (n,)."""
        n = self.num_envs
        size = len(self.pool.instances)
        new = torch.randint(size, (n,), generator=self._torch, device=self.device)
        self.instance[:] = torch.where(fresh, new, self.instance)
        rows = {key: value[self.instance] for key, value in self._rows.items()}

        def put(memory: Tensor, value: Any) -> None:
            mask = fresh.view(n, *[1] * (memory.ndim - 1))
            memory.copy_(torch.where(mask, value, memory))

        self.base.copy_(rows["base"])
        qpos = self._start(rows["qpos"], rows["base"])
        put(self.qpos, qpos)
        wanted = qpos[:, self.joint_at].flatten(1)
        put(self.angle, wanted)
        put(self._wanted, wanted)
        ctrl = torch.zeros_like(self.ctrl)
        for k, robot in enumerate(self.robots):
            ctrl[:, robot.ctrl] = wanted[:, 6 * k : 6 * k + 6]
        ctrl[:, self._grips] = FINGER_OPENING_M
        put(self.ctrl, ctrl)
        for memory in (
            *(self.qvel, self._warm, self.rate, self._awake, self._thrown),
            *(self._age, self._settled, self.touch),
        ):
            put(memory, torch.zeros((), dtype=memory.dtype, device=self.device))
        for key, memory in self._bodies.items():
            memory[:, list(self.pool.moved)] = rows[key]
        for key, memory in self._geoms.items():
            memory[:, list(self.pool.geoms)] = rows[key]
        self._gravcomp.copy_(rows["gravcomp"])
        free = [self.pool.scene.qpos_of(name) for name in self.pool.scene.movable_names]
        at = torch.tensor([[a, a + 1] for a in free], device=self.device)
        left = torch.cat([qpos[:, at], torch.zeros(n, len(free), 1).to(qpos)], -1)
        put(self._left, left)
        self._place_hands()
        put(self.target, self.here)

    def _start(self, qpos: Tensor, base: Tensor) -> Tensor:
        """Return first states, some with robot 0's hand near the first object."""
        if not self.near:
            return qpos
        n = len(qpos)
        name = self.pool.scene.object_names[min(s for s in self.pool.goal[0] if s >= 0)]
        at = self.pool.scene.qpos_of(name)
        noise = torch.rand(n, 5, generator=self._torch, device=self.device)
        spot = qpos[:, None, at : at + 3] + 0.12 * (noise[:, None, :3] - 0.5)
        spot[..., 2] = 0.03 + 0.12 * noise[:, None, 2]
        yaw = math.tau * noise[:, None, 3:4]
        one = Arms(*(part[:1] for part in vars(self.arms).values()))
        joint = self.joint_at[0]
        way = joints(torch.cat([spot, yaw], -1), base[:, :1], one, qpos[:, None, joint])
        chosen = (noise[:, 4] < self.near) & (spot[:, 0, 2] > 0.085)
        moved = qpos.clone()
        moved[:, joint] = torch.where(chosen[:, None], way[:, 0], qpos[:, joint])
        return moved

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Set all tables; a seed seeds which instances are drawn."""
        del options
        if seed is not None:
            self._torch.manual_seed(seed)
        self._begin(torch.ones_like(self._age, dtype=torch.bool))
        self.signals.look()
        self.potential.copy_(self.signals.potential())
        return self._observe(), {"instance": self.instance.clone()}

    def sentences(self) -> list[str]:
        """Return what is asked for on each table; copies numbers from the device."""
        found = self.pool.instances
        return [found[i].instructions["high_level"] for i in self.instance.tolist()]

    def _command(self, action: Tensor) -> None:
        n, count = self.num_envs, len(self.robots)
        rows = action.view(n, count, -1)
        now = self._wanted.view(n, count, 6)
        if self.control == "delta_hand":
            target = advance(self.target, rows, self.here, self.base, self.arms)
            found = joints(target, self.base, self.arms, now)
            # A hand that is not asked to move stays as it is.
            still = (rows[..., :4] == 0.0).all(-1, keepdim=True)
            now = torch.where(still, now, found)
            self.target.copy_(target)
            grip = openings(rows)
        else:
            rows = rows.clamp(-1, 1) if self.control == "delta_joint" else rows
            step = JOINT_STEP_RAD * rows[..., :6]
            now = now + step if self.control == "delta_joint" else rows[..., :6]
            grip = rows[..., 6]
            if self.control == "delta_joint":
                grip = (0.5 + 0.5 * grip) * FINGER_OPENING_M
        self._wanted.copy_(now.reshape(n, -1))
        self.ctrl[:, self._grips] = grip

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
        self._command(action.to(self.device, torch.float32))
        self._simulate()
        lost = self._drop_lost()
        self._place_hands()
        self.signals.look()
        holds = self.signals.succeeds() & ~lost
        self._settled.copy_(torch.where(holds, self._settled + 1, 0))
        thrown = self._thrown > 0
        success = (self._settled >= self._settle) & ~thrown
        terminated = success | thrown
        truncated = ((self._age >= self._horizon) | lost) & ~terminated
        after = self.signals.potential()
        reward = self._reward(after, success, terminated)
        final, done = self._observe(), terminated | truncated
        self._begin(done)
        self._place_hands()
        self.signals.look()
        self.potential.copy_(torch.where(done, self.signals.potential(), after))
        info = {
            "success": success,
            "thrown": thrown,
            "lost": lost,
            "instance": self.instance.clone(),
            "final_obs": final,
            "_final_obs": done,
        }
        return self._observe(), reward, terminated, truncated, info

    def _drop_lost(self) -> Tensor:
        """Reset and count worlds that are lost; return which, (n,)."""
        self._age += 1
        self._steps += 1
        if self._steps % _CHECK_STEPS == 0:
            self.check()
        lost = ~(self.qpos.isfinite().all(1) & self.qvel.isfinite().all(1))
        lost |= self.qvel.abs().amax(1) > 1e3
        self._begin(lost)
        self.lost_worlds += lost.sum()
        found: Tensor = lost
        return found

    def _reward(self, after: Tensor, success: Tensor, terminated: Tensor) -> Tensor:
        won = success.float()
        if self.reward == "sparse":
            return won
        if self.reward == "level":
            return torch.where(terminated, won, (1.0 - self.discount) * after)
        ended = torch.where(terminated, won, after)
        return won + self.discount * ended - self.potential

    def _observe(self) -> dict[str, Tensor]:
        """Return what is observed, each (n, numbers) in the order of the robots."""
        n, count = self.num_envs, len(self.robots)
        self.signals.look()
        opening = self.qpos[:, self._fingers].sum(-1).clamp(0.0, FINGER_OPENING_M)
        speeds = self.qvel[:, self._dofs]
        rate = torch.cat([speeds[..., :6], speeds[..., 6:].sum(-1, keepdim=True)], -1)
        parts = torch.cat([self.qpos[:, self.joint_at], opening[..., None]], -1)
        return {
            "agent_pos": parts.reshape(n, 7 * count),
            "agent_vel": rate.reshape(n, 7 * count),
            "goal_state": self.signals.goal_state(opening).reshape(n, -1),
            "target": self.target.clone(),
            "here": self.here,
            "base": self.base.clone(),
        }
