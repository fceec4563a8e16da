"""The control step of all worlds in torch, except the physics.

Everything here can be recorded as a CUDA graph: memory is allocated once, shapes do not
depend on data, the host reads nothing, and indices are on the device.
"""

from typing import Any

import torch
from torch import Tensor

from lemma.env.control.pose_controllers import LEASH_STEPS
from lemma.policies.control.hand_starts import starts
from lemma.policies.control.hand_steps import advance, joints, openings, pace
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import kind_of
from lemma.warp.draws import Draws, uniform
from lemma.warp.hands import moved, pose_joints, upright
from lemma.warp.signals import Signals
from lemma.warp.worlds import Worlds

JOINT_STEP_RAD = 0.1
"""Joint step of the action 1 in ``delta_joint``."""
_TOO_FAST = 1e3


class Episodes(Worlds):
    """Episodes in many worlds: actions, signals, rewards, ends, resets."""

    control: str
    reward: str
    discount: float
    signals: Signals
    draws: Draws
    lost_worlds: Tensor
    _action: Tensor
    _near: float
    _share: Tensor
    _settle: int
    _horizon: int

    def _begin(self, fresh: Tensor) -> None:
        """Reset some worlds.

        Args:
            fresh: Mask of the worlds, (n,) bool.
        """
        n = self.num_envs
        drawn = self.draws.draw()
        new = drawn[:, 0] % len(self.pool.instances)
        torch.where(fresh, new, self.instance, out=self.instance)
        rows = {key: value[self.instance] for key, value in self._rows.items()}

        def put(memory: Tensor, value: Tensor) -> None:
            mask = fresh.view(n, *[1] * (memory.ndim - 1))
            memory.copy_(torch.where(mask, value, memory))

        self.base.copy_(rows["base"])
        qpos, asked = self._start(rows["qpos"], rows["base"], drawn)
        put(self.qpos, qpos)
        wanted = qpos[:, self.joint_at].flatten(1)
        put(self.angle, wanted)
        put(self._wanted, wanted)
        ctrl = torch.zeros_like(self.ctrl)
        ctrl[:, self._at["motors"].flatten()] = wanted
        ctrl[:, self._at["grips"]] = asked
        put(self.ctrl, ctrl)
        for memory in (
            *(self.qvel, self._warm, self.rate, self._awake, self._thrown),
            *(self._age, self._settled, self.touch),
        ):
            memory.masked_fill_(fresh.view(n, *[1] * (memory.ndim - 1)), 0)
        for key, memory in self._bodies.items():
            memory[:, self._at["moved"]] = rows[key]
        for key, memory in self._geoms.items():
            memory[:, self._at["geoms"]] = rows[key]
        self._gravcomp.copy_(rows["gravcomp"])
        put(self._left[..., :2], qpos[:, self._at["free"]])
        put(self._left[..., 2], torch.zeros_like(self._left[..., 2]))
        self._place_hands()
        put(self.target, self.here)
        put(self.aim, self.hands)
        self.signals.look()

    def _start(
        self, qpos: Tensor, base: Tensor, drawn: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return initial states, some with a hand near the object.

        Returns:
            ``qpos``, (n, nq), and the commanded openings, (n, robots) [m].
        """
        asked = torch.full_like(base[..., 0], FINGER_OPENING_M)
        if not self._near:
            return qpos, asked
        scene = self.pool.scene
        name = scene.object_names[min(s for s in self.pool.goal[0] if s >= 0)]
        at, kind = scene.qpos_of(name), kind_of(name)
        where = qpos[:, None, at : at + 4].clone()
        where[..., 3] = 2.0 * torch.atan2(qpos[:, at + 6], qpos[:, at + 3])[:, None]
        if kind.grasp is not None:
            where[..., 2] += kind.grasp.height_m - kind.origin_m
        quarter = kind.grasp.turn_rad if kind.grasp is not None else 0.0
        noise, angles = uniform(drawn[:, None, 1:7]), qpos[:, self.joint_at]
        q, opening, closed, possible = starts(
            where, quarter, base, self.arms, angles, noise[..., :5]
        )
        far = torch.linalg.vector_norm(where[..., :2] - base[..., :2], dim=-1)
        first = (far / self.arms.radii[:, 1]).argmin(-1, keepdim=True)
        chosen = possible & (noise[..., 5] < self._share)
        chosen = chosen & (first == self._at["numbers"])
        found = qpos.clone()
        found[:, self.joint_at] = torch.where(chosen[..., None], q, angles)
        fingers = found[:, self._at["fingers"]]
        half = 0.5 * opening[..., None].expand_as(fingers)
        found[:, self._at["fingers"]] = torch.where(chosen[..., None], half, fingers)
        return found, torch.where(chosen, closed, asked)

    def _command(self) -> None:
        """Set the motor targets from the actions in memory."""
        n, count = self.num_envs, len(self.robots)
        rows = self._action.view(n, count, -1)
        now = self._wanted.view(n, count, 6)
        if self.control == "delta_hand":
            target = advance(
                self.target, rows, self.here, self.base, self.arms, self._slow
            )
            found = joints(target, self.base, self.arms, now)
            # A zero action keeps the joint targets.
            still = (rows[..., :4] == 0.0).all(-1, keepdim=True)
            now = torch.where(still, now, found)
            self.target.copy_(target)
            grip = openings(rows, self.asked)
        elif self.control == "delta_ee_pose":
            rows = rows.clamp(-1, 1)
            aim = moved(self.aim, rows, self.hands)
            found = pose_joints(aim, self.base, self.arms, now)
            still = (rows[..., :6] == 0.0).all(-1, keepdim=True)
            now = torch.where(still, now, found)
            self.aim.copy_(aim)
            self.target.copy_(upright(aim))
            grip = (0.5 + 0.5 * rows[..., 6]) * FINGER_OPENING_M
        elif self.control == "delta_joint":
            rows = rows.clamp(-1, 1)
            now = self._led(now + JOINT_STEP_RAD * rows[..., :6])
            grip = (0.5 + 0.5 * rows[..., 6]) * FINGER_OPENING_M
        else:
            now, grip = rows[..., :6], rows[..., 6]
        self._wanted.copy_(now.reshape(n, -1))
        self.ctrl[:, self._at["grips"]] = grip

    def _led(self, wanted: Tensor) -> Tensor:
        """Return joint targets in range, at most two steps ahead of the arms [rad]."""
        here, leash = self.qpos[:, self.joint_at], LEASH_STEPS * JOINT_STEP_RAD
        near = torch.minimum(torch.maximum(wanted, here - leash), here + leash)
        return torch.minimum(torch.maximum(near, -self.joint_range), self.joint_range)

    def _judge(self) -> dict[str, Any]:
        """Return the results of a step: rewards, ends, resets and observations."""
        self._age += 1
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
        self.potential.copy_(torch.where(done, self.signals.potential(), after))
        return {
            "observation": self._observe(),
            "reward": reward,
            "terminated": terminated,
            "truncated": truncated,
            "success": success,
            "thrown": thrown,
            "lost": lost,
            "instance": self.instance,
            "final_obs": final,
            "_final_obs": done,
        }

    def _drop_lost(self) -> Tensor:
        """Restore the initial state of diverged worlds; count and return them, (n,).

        The step ends their episodes, and resets them.
        """
        lost = ~(self.qpos.isfinite().all(1) & self.qvel.isfinite().all(1))
        lost |= self.qvel.abs().amax(1) > _TOO_FAST
        first = self._rows["qpos"][self.instance]
        self.qpos.copy_(torch.where(lost[:, None], first, self.qpos))
        self.qvel.masked_fill_(lost[:, None], 0)
        self.touch.masked_fill_(lost[:, None, None], 0)
        self._thrown.masked_fill_(lost, 0)
        self.lost_worlds += lost.sum()
        found: Tensor = lost
        return found

    def _reward(self, after: Tensor, success: Tensor, terminated: Tensor) -> Tensor:
        won = success.float()
        if self.reward == "sparse":
            return won
        if self.reward == "rise":
            # A throw ends the episode without a penalty.
            rise = torch.where(success, 1.0, after) - self.potential
            return won + torch.where(terminated & ~success, 0.0, rise)
        if self.reward == "level":
            return torch.where(terminated, won, (1.0 - self.discount) * after)
        ended = torch.where(terminated, won, after)
        return won + self.discount * ended - self.potential

    def _observe(self) -> dict[str, Tensor]:
        """Return observations by name, (n, numbers) each, in the order of robots."""
        n, count = self.num_envs, len(self.robots)
        opening = self.opening
        goal = self.signals.goal_state(opening)
        self._slow.copy_(pace(goal))
        speeds = self.qvel[:, self._at["dofs"]]
        rate = torch.cat([speeds[..., :6], speeds[..., 6:].sum(-1, keepdim=True)], -1)
        parts = torch.cat([self.qpos[:, self.joint_at], opening[..., None]], -1)
        return {
            "agent_pos": parts.reshape(n, 7 * count),
            "agent_vel": rate.reshape(n, 7 * count),
            "goal_state": goal.reshape(n, -1),
            "target": self.target.clone(),
            "here": self.here,
            "base": self.base.clone(),
            "asked": self.asked,
        }

    def _mutable(self) -> list[Tensor]:
        """Return all tensors that a control step changes."""
        return [
            *(self.qpos, self.qvel, self.ctrl, self._warm, self.angle, self.rate),
            *(self._wanted, self.hands, self.target, self.base, self.touch),
            self.aim,
            *(self._left, self._awake, self._thrown, self.instance, self._age),
            *(self._settled, self.potential, self._slow, self.lost_worlds),
            self.draws.state,
            *(*self._bodies.values(), *self._geoms.values(), self._gravcomp),
        ]
