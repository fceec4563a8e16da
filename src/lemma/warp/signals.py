"""Goals, potentials and goal states of many worlds, in torch.

They equal :mod:`lemma.tasks.goal`, :mod:`lemma.env.signals.rewards` and
:mod:`lemma.env.signals.goal_state` on the CPU, for cubes and pads.
"""

import math
from typing import Any

import torch
from torch import Tensor

from lemma.env.signals.rewards import AROUND_M, ASIDE_M, HIGH_M, SLOPE
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import (
    HOVER_M,
    LIFTED_M,
    OVER_M,
    REST_M_S,
    REST_RAD_S,
    TILT_RAD,
)


class Signals:
    """Goals and potentials of a :class:`~lemma.warp.vector_env.GpuVecEnv`."""

    def __init__(self, env: Any) -> None:
        """Store the environment, whose tensors are read."""
        self._env = env
        self._goal = env.pool.goal
        scene = env.pool.scene
        self._kinds = [kind_of(name) for name in scene.object_names]
        free = [scene.qpos_of(name) for name in scene.movable_names]
        dofs = [int(scene.model.joint(name).dofadr[0]) for name in scene.movable_names]
        self._free = torch.tensor(free, device=env.device)[:, None] + torch.arange(
            7, device=env.device
        )
        self._dofs = torch.tensor(dofs, device=env.device)[:, None] + torch.arange(
            6, device=env.device
        )
        self._slots, self._count = len(self._kinds), len(env.robots)
        wanted = [top for top, bottom in self._goal if bottom < 0]
        others = [k for k in range(self._slots) if k not in wanted]
        # A tensor, because each use of a list as an index copies it from the host.
        self._others = torch.tensor(others, dtype=torch.int64, device=env.device)

    def look(self) -> None:
        """Read the present poses of objects."""
        env = self._env
        self._parts: dict[tuple[int, int], Tensor] = {}
        poses = env._rows["fixed"][env.instance].clone()
        moving = len(self._free)
        poses[:, :moving] = env.qpos[:, self._free]
        speeds = env.qvel[:, self._dofs].view(len(poses), moving, 2, 3)
        motion = poses.new_zeros(len(poses), self._slots, 2)
        motion[:, :moving] = torch.linalg.vector_norm(speeds, dim=-1)
        self.at, self._turn = poses[..., :3], poses[..., 3:]
        self._rests = (motion[..., 0] < REST_M_S) & (motion[..., 1] < REST_RAD_S)
        self._touch = env.touch
        self._tcp = env.hands[..., :3]
        hold = [self._pads(r) for r in range(self._count)]
        self.holds = torch.stack(hold, -1)

    def _pads(self, robot: int) -> Tensor:
        both = 6 << (1 + self._slots + 3 * robot)
        return (self._touch[..., 0] & both) == both

    def _robots(self, slot: int) -> Tensor:
        mask = ((1 << 3 * self._count) - 1) << (1 + self._slots)
        return (self._touch[:, slot, 0] & mask) != 0

    def _part(self, pair: tuple[int, int]) -> Tensor:
        """Return whether a pair of the goal holds, (n,); cached until :meth:`look`."""
        if pair not in self._parts:
            self._parts[pair] = self._holds(*pair)
        return self._parts[pair]

    def _holds(self, top: int, bottom: int) -> Tensor:
        if top < 0:
            off = self._tcp - self.at[:, bottom, None]
            above = off[..., 2] - self._kinds[bottom].top_m
            over = torch.linalg.vector_norm(off[..., :2], dim=-1) <= OVER_M
            near = (over & (above >= 0.0) & (above <= HOVER_M)).any(1)
            calm = self._rests[:, bottom] & (self.at[:, bottom, 2] >= 0.0)
            return near & calm & ~self._robots(bottom)
        touch = self._touch[:, top]
        if bottom < 0:
            high = self.at[:, top, 2] - self._kinds[top].origin_m >= LIFTED_M
            others = touch[:, 0] & ((1 << (1 + self._slots)) - 1)
            return high & (others == 0) & (self.holds[:, top].sum(-1) == 1)
        off = self.at[:, top] - self.at[:, bottom]
        limit = self._kinds[bottom].support_m or 0.0
        above = (torch.linalg.vector_norm(off[:, :2], dim=-1) <= limit) & (
            off[:, 2] > 0.0
        )
        calm = self._rests[:, top] & self._rests[:, bottom]
        level = self._upright(top) & self._upright(bottom)
        bit, things = 1 << (1 + bottom), ((1 << self._slots) - 1) << 1
        alone = (touch[:, 0] & ~things) == 0
        alone &= (touch[:, 2] & things & ~bit) == 0
        carried = (touch[:, 1] & bit) != 0
        if not self._kinds[bottom].fixed:
            alone &= ~self._robots(bottom)
        high = (self.at[:, top, 2] >= 0.0) & (self.at[:, bottom, 2] >= 0.0)
        return above & calm & level & alone & carried & high

    def _upright(self, slot: int) -> Tensor:
        w, x, y, z = self._turn[:, slot].unbind(-1)
        up = torch.stack(
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1
        )
        return up.abs().amax(-1) >= math.cos(TILT_RAD)

    def succeeds(self) -> Tensor:
        """Return whether the goal holds and no other object is held, (n,)."""
        found = ~self.holds[:, self._others].any(-1).any(-1)
        for pair in self._goal:
            found = found & self._part(pair)
        return found

    def potential(self) -> Tensor:
        """Return the potential of each world, as ``goal_potential``, (n,)."""
        parts = [
            torch.where(self._part(pair), 1.0, self._share(pair)) for pair in self._goal
        ]
        return torch.stack(parts).mean(0)

    def _share(self, pair: tuple[int, int]) -> Tensor:
        top, bottom = pair
        if top < 0:
            over = self.at[:, bottom].clone()
            over[:, 2] += self._kinds[bottom].top_m + 0.5 * HOVER_M
            return 0.9 * self._near(over)
        at, held = self.at[:, top], self.holds[:, top].any(-1)
        about = torch.where(held, 1.0, self._grip(top))
        lifted = (at[:, 2] - self._kinds[top].origin_m).clamp(0.0, LIFTED_M) / LIFTED_M
        if bottom < 0:
            return 0.5 * about + torch.where(held, 0.15 + 0.3 * lifted, 0.0)
        place, limit = self._place(pair), self._kinds[bottom].support_m or 0.0
        beside = torch.linalg.vector_norm((at - place)[:, :2], dim=-1)
        placed = (beside <= limit) & ((at - place)[:, 2].abs() <= 0.01)
        lifted = torch.maximum(lifted, 1.0 - beside / LIFTED_M)
        hand = 0.25 * about + torch.where(held, 0.1 + 0.15 * lifted, 0.0)
        there = nearness(torch.linalg.vector_norm(at - place, dim=-1))
        return torch.where(placed, 0.5, hand) + 0.4 * there

    def _near(self, at: Tensor) -> Tensor:
        way = torch.linalg.vector_norm(self._tcp - at[:, None], dim=-1).amin(1)
        return nearness(way)

    def _grip(self, slot: int) -> Tensor:
        """Return the largest :func:`grip` of all hands for an object, (n,)."""
        at, turn, quarter = self._grasp(slot)
        off = self._tcp - at[:, None]
        if quarter:
            turn = 2.0 * turn / quarter
        beside = torch.linalg.vector_norm(off[..., :2], dim=-1)
        opening = self._env.opening / FINGER_OPENING_M
        return grip(beside, off[..., 2], turn, opening).amax(1)

    def _grasp(self, slot: int) -> tuple[Tensor, Tensor, float]:
        """Return an object's grasp position, the hands' yaw errors and its symmetry."""
        kind, at = self._kinds[slot], self.at[:, slot].clone()
        hands = self._env.hands
        if kind.grasp is None:
            return at, torch.zeros_like(hands[..., 0]), 0.0
        at[:, 2] += kind.grasp.height_m - kind.origin_m
        w, x, y, z = self._turn[:, slot].unbind(-1)
        yaw = torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        turn = yaw[:, None] - torch.atan2(hands[..., 6], hands[..., 3])
        quarter = kind.grasp.turn_rad
        if not quarter:
            return at, torch.zeros_like(turn), 0.0
        return at, turn - torch.round(turn / quarter) * quarter, quarter

    def _place(self, pair: tuple[int, int]) -> Tensor:
        top, bottom = pair
        found = self.at[:, bottom if top < 0 or bottom >= 0 else top].clone()
        if top >= 0 and bottom >= 0:
            found[:, 2] += self._kinds[bottom].top_m + self._kinds[top].origin_m
        elif top >= 0:
            found[:, 2] = self._kinds[top].origin_m + LIFTED_M
        return found

    def goal_state(self, opening: Tensor) -> Tensor:
        """Return the numbers of :data:`.goal_state.NUMBERS`, (n, robots, 13)."""
        found = self._of_part(self._goal[-1], opening)
        for pair in self._goal[-2::-1]:
            mine = self._of_part(pair, opening)
            found = torch.where(self._part(pair)[:, None, None], found, mine)
        return found

    def _of_part(self, pair: tuple[int, int], opening: Tensor) -> Tensor:
        slot = pair[1] if pair[0] < 0 else pair[0]
        here = self.at[:, slot]
        at, turn, _ = self._grasp(slot)
        env, hands = self._env, self._env.hands
        away = self._tcp[..., :2] - env.base[..., :2]
        reach = torch.linalg.vector_norm(away, dim=-1)
        ahead = away / reach[..., None].clamp_min(1e-6)

        def seen(vector: Tensor) -> list[Tensor]:
            a, b = ahead.unbind(-1)
            return [
                a * vector[..., 0] + b * vector[..., 1],
                a * vector[..., 1] - b * vector[..., 0],
                vector[..., 2] + 0.0 * a,
            ]

        axis = hands[..., 5::3]
        way = (self._place(pair) - here)[:, None].expand_as(self._tcp)
        numbers = [reach, self._tcp[..., 2], *seen(axis)[:2], opening]
        numbers += [self.holds[:, slot].float(), *seen(at[:, None] - self._tcp), turn]
        return torch.stack([*numbers, *seen(way)], -1)


def nearness(distance_m: Tensor) -> Tensor:
    """Return :func:`lemma.env.signals.rewards.nearness` of tensors."""
    coarse = 1.0 - (distance_m / 2.0).clamp_max(1.0)
    return 0.5 * coarse + 0.5 * (1.0 - torch.tanh(distance_m / 0.1))


def grip(beside_m: Tensor, above_m: Tensor, turn: Tensor, opening: Tensor) -> Tensor:
    """Return :func:`lemma.env.signals.rewards.grip` of tensors."""
    way = (SLOPE * (beside_m - ASIDE_M)).clamp(0.0, HIGH_M)
    far_m = torch.hypot(beside_m, torch.maximum(above_m, way))
    far_m = far_m + (way - above_m).clamp_min(0.0)
    around = (1.0 - far_m / AROUND_M).clamp_min(0.0)
    closed = (2.0 - 2.0 * opening).clamp_max(1.0)
    fingers = (1.0 - around) * opening + around * (1.0 + 2.0 * closed)
    return 0.7 * nearness(far_m) * (1.0 - 0.15 * turn.abs()) + 0.1 * fingers
