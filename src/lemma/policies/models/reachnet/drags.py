"""ReachNet's drags: ways to move a cube with the stick, and what each is worth.

A drag is one of a few bearings and lengths. Its utility is learned from demonstrations:
a weighted sum of what makes a drag good, and one soft threshold for each thing that
makes it impossible. The thresholds act on what the network perceives: how far inside
its reach maps the gripper and the cube would be, and what would be in the way.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.models.reachnet.scene_table import CUBES, THE_STICK, SceneTable
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.stick import (
    GRASP_FROM_END_M,
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_SECTION_M,
)
from lemma.tasks.drags import PREPARE_GAP_M

TOOL_PRIMITIVES = ("hook", "poke")
SIGNS = (-1.0, 1.0)
"""Which way along the stick each of them moves the cube."""
TURNS_RAD = tuple(
    math.radians(d) for d in (-54, -42, -32, -24, -16, -8, 0, 8, 16, 24, 32, 42, 54)
)
"""Bearings of the stick, from the direction in which the robot sees the cube."""
TRAVELS_M = tuple(round(0.12 + 0.02 * i, 2) for i in range(9))
"""How far the gripper moves."""

_TAIL_M = -GRASP_FROM_END_M
_BAR_M = HANDLE_LENGTH_M - STICK_SECTION_M / 2 - GRASP_FROM_END_M
_ACROSS_M = HOOK_LENGTH_M - STICK_SECTION_M / 2
"""The stick, from where it is grasped: end of the handle, hook, length of the hook."""
_CONSTRAINTS = 6
_SCALES_M = (0.02, 0.02, 0.02, 0.02, 0.02, 0.1)
_SCALE_M = 0.02
_READY_UNIT_M = 0.1
_SPEED = 10.0


@dataclass(frozen=True, eq=False)
class Drags:
    """All drags of some cubes; T turns, L lengths, S primitives, R robots, C cubes."""

    constraints: Tensor
    """What must be large enough [m], (B, R, S, C, T, L, 6): margins of the gripper at
    both ends and of the cube's end, room for stick, for cube, and around bases."""
    bearings: Tensor
    """Of the stick [rad], (B, R, S, C, T)."""
    prepared: Tensor
    """Gripper where the stick is put down, (B, R, S, C, T, 2) [m]."""


class Tuned(nn.Module):
    """A few numbers that training moves ten times as fast as weights."""

    start: Tensor

    def __init__(self, start: Sequence[Any]) -> None:
        """Begin with some numbers.

        Args:
            start: The numbers, nested as their shape is.
        """
        super().__init__()
        values = torch.tensor(start)
        self.register_buffer("start", values, persistent=False)
        # One-dimensional, because weights of more dimensions decay.
        self.change = nn.Parameter(torch.zeros(values.numel()))

    def forward(self) -> Tensor:
        """Return the numbers."""
        return self.start + _SPEED * self.change.view_as(self.start)


class DragUtility(nn.Module):
    """What drags are worth: the paper's u = q - c, with soft edges."""

    def __init__(self, use_reach: bool = True) -> None:
        """Make the weights.

        Args:
            use_reach: Whether margins of reach count.
        """
        super().__init__()
        self.use_reach = use_reach
        self.ready_units = Tuned([[3.5, 0.7], [4.5, 0.7]])
        count = len(TOOL_PRIMITIVES)
        self.threshold = Tuned([[1.0] * _CONSTRAINTS] * count)
        self.sharpness = Tuned([[0.5] * _CONSTRAINTS] * count)
        self.enough = Tuned([4.0] * count)
        self.weights = Tuned([[0.0] * 3] * count)

    @property
    def ready(self) -> Tensor:
        """Where a cube is, seen from the gripper, when the stick lies ready, (S, 2)."""
        units: Tensor = self.ready_units()
        return _READY_UNIT_M * units

    def drags(self, table: SceneTable, cubes: Tensor | None = None) -> Drags:
        """Return what there is to choose from.

        Args:
            table: B scenes.
            cubes: Numbers of cubes, (B, C); all if None.
        """
        if cubes is None:
            cubes = torch.arange(len(CUBES), device=table.xy.device)
            cubes = cubes.expand(len(table), -1)
        cube = table.xy.gather(1, cubes[..., None].expand(-1, -1, 2))
        ray = cube[:, None] - table.bases[:, :, None]
        outward = torch.atan2(ray[..., 1], ray[..., 0])
        bearings = outward[:, :, None, :, None] + torch.tensor(
            TURNS_RAD, device=cube.device
        )
        bearings = bearings.expand(-1, -1, len(TOOL_PRIMITIVES), -1, -1)
        ahead = torch.stack([bearings.cos(), bearings.sin()], -1)
        left = torch.stack([-ahead[..., 1], ahead[..., 0]], -1)
        ready = self.ready.detach()[:, None, None]
        at = cube[:, None, None, :, None]
        prepared = at - ready[..., :1] * ahead - ready[..., 1:] * left
        signs = torch.tensor(SIGNS, device=cube.device)[:, None, None, None, None]
        travel = torch.tensor(TRAVELS_M, device=cube.device)[:, None]
        moves = signs * ahead.unsqueeze(-2) * travel
        end = prepared.unsqueeze(-2) + moves
        cube_end = at.unsqueeze(-2) + moves * (1 - PREPARE_GAP_M / travel)
        parts = [
            _own(table.margins(prepared)).unsqueeze(-1).expand(end.shape[:-1]),
            _own(table.margins(end)),
            _receiver(table.margins(cube_end)),
            *self._room(table, cubes, prepared, ahead, left),
        ]
        return Drags(torch.stack(parts, -1), bearings, prepared)

    def forward(self, drags: Drags) -> Tensor:
        """Return the utility of drags, (B, R, S, C, T, L)."""
        return self._able(drags.constraints) + self._worth(drags.constraints)

    def values(self, drags: Drags) -> Tensor:
        """Return what is known of the best drag, (B, R, S, C, 3).

        Returns:
            Its utility, how possible it is (0: surely, below: less), and how possible
            the most possible drag is.
        """
        able = self._able(drags.constraints)
        worth = (able + self._worth(drags.constraints)).flatten(-2)
        able = able.flatten(-2)
        best = worth.argmax(-1, keepdim=True)
        found = [worth.gather(-1, best), able.gather(-1, best)]
        return torch.cat([*found, able.amax(-1, keepdim=True)], -1)

    def _able(self, constraints: Tensor) -> Tensor:
        sharp = self.sharpness().exp()[:, None, None, None]
        threshold = self.threshold()[:, None, None, None]
        scales = torch.tensor(_SCALES_M, device=constraints.device)
        soft = F.logsigmoid(sharp * (constraints / scales - threshold))
        if not self.use_reach:
            soft = soft[..., 3:]
        return soft.sum(-1)

    def _worth(self, constraints: Tensor) -> Tensor:
        device = constraints.device
        enough = self.enough()[:, None, None, None]
        weights = self.weights().exp()[:, None, None, None]
        quality = torch.minimum(constraints[..., 2] / _SCALE_M, enough)
        quality = quality * float(self.use_reach)
        length = torch.tensor(TRAVELS_M, device=device) / _SCALE_M
        turn = torch.tensor(TURNS_RAD, device=device).abs()[:, None]
        worth: Tensor = (
            weights[..., 0] * quality
            - weights[..., 1] * length
            - weights[..., 2] * 10 * turn
        )
        return worth

    def _room(
        self,
        table: SceneTable,
        cubes: Tensor,
        prepared: Tensor,
        ahead: Tensor,
        left: Tensor,
    ) -> list[Tensor]:
        """Return the room of stick and cube, and around bases, (B, R, S, C, T, L)."""
        device = table.xy.device
        things = torch.cat([table.xy[:, :THE_STICK], table.bases], 1)
        radii = torch.full((things.shape[1],), 0.0, device=device)
        radii[: len(CUBES)] = CUBE.disc_m
        radii[len(CUBES) : THE_STICK] = PAD.disc_m
        offset = things[:, None, None, None, None] - prepared.unsqueeze(-2)
        u = (offset * ahead.unsqueeze(-2)).sum(-1)[..., None, :]
        v = (offset * left.unsqueeze(-2)).sum(-1)[..., None, :]
        signs = torch.tensor(SIGNS, device=device)[:, None, None, None, None]
        travel = torch.tensor(TRAVELS_M, device=device)[:, None] * signs
        back, forth = travel.clamp(max=0.0), travel.clamp(min=0.0)
        handle = _beyond(u, _TAIL_M + back, _BAR_M + forth).hypot(v)
        bar = _beyond(u, _BAR_M + back, _BAR_M + forth).hypot(
            _beyond(v, torch.zeros_like(back), torch.full_like(back, _ACROSS_M))
        )
        stick = torch.minimum(handle, bar) - radii
        ready = self.ready.detach()[:, None, None, None, None]
        moved = travel - signs * PREPARE_GAP_M
        start = ready[..., 0]
        path = _beyond(u, start + moved.clamp(max=0), start + moved.clamp(min=0))
        cube = path.hypot(v - ready[..., 1]) - radii
        own = F.one_hot(cubes, things.shape[1]).bool()[:, None, None, :, None, None]
        stick = torch.where(own, 1.0, stick)
        cube = torch.where(own, 1.0, cube)
        bases = torch.minimum(stick, cube)[..., THE_STICK:].amin(-1)
        found = [stick[..., :THE_STICK].amin(-1), cube[..., :THE_STICK].amin(-1), bases]
        # Room that is more than enough is all the same.
        return [room.clamp(max=1.0) for room in found]


def stick_distance(grasp: Tensor, yaw: Tensor, points: Tensor) -> Tensor:
    """Return the distance of points from the axes of lying sticks [m], (...).

    Args:
        grasp: Where the stick is grasped, (..., 2) [m].
        yaw: Of the stick, (...) [rad].
        points: (..., 2) [m].
    """
    x, y = (points - grasp).unbind(-1)
    u, v = x * yaw.cos() + y * yaw.sin(), y * yaw.cos() - x * yaw.sin()
    handle = (u - u.clamp(_TAIL_M, _BAR_M)).hypot(v)
    bar = (u - _BAR_M).hypot(v - v.clamp(0.0, _ACROSS_M))
    return torch.minimum(handle, bar)


def _beyond(x: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return the distance of numbers from an interval."""
    return torch.maximum(low - x, x - high).clamp(min=0.0)


def _own(margins: Tensor) -> Tensor:
    """Return each robot's margin of its own points, (B, R, ...).

    Args:
        margins: Of every robot at the points of every robot, (B, R, R, ...).
    """
    return torch.stack([margins[:, i, i] for i in range(margins.shape[1])], 1)


def _receiver(margins: Tensor) -> Tensor:
    """Return the margin of who shall reach the cube at its end, (B, R, S, ...).

    That is oneself after a hook, and another robot after a poke.
    """
    robots = margins.shape[1]
    rows = []
    for i in range(robots):
        others = [margins[:, j, i, 1] for j in range(robots) if j != i]
        given = torch.stack(others).amax(0)
        rows.append(torch.stack([margins[:, i, i, 0], given], 1))
    return torch.stack(rows, 1)
