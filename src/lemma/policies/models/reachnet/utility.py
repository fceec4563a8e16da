"""ReachNet's utilities of drags with the stick, and of positions for cubes and stick.

The candidates for a cube or the stick are positions on a grid. A utility is learned
from demonstrations. It is a weighted sum of features, plus a soft threshold for each
constraint, which is a margin inside the estimated reach or a clearance from obstacles.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.layers import constant
from lemma.policies.models.grid import wrapped
from lemma.policies.models.reachnet.drags import (
    SIGNS,
    TRAVELS_M,
    TURNS_RAD,
    DragCandidates,
    Drags,
)
from lemma.policies.models.reachnet.scene_table import (
    BAR_M,
    FAR_M,
    HALF_M,
    SceneTable,
    stick_distance,
)
from lemma.tasks.drags import HAND_CLEARANCE_M, LARGEST_TURN_RAD, PREPARE_GAP_M

_SCALES_M = (0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.1, 0.05)
_FIRST = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, HAND_CLEARANCE_M / 0.02, 1.0, 10.0)
"""Initial thresholds, in these units."""
_OF_REACH = 4
"""Number of constraints of reach, which come first."""
_RECEIVER = 2
_SCALE_M = 0.02
_READY_UNIT_M = 0.1
_FIRST_GAP_M = HALF_M + PREPARE_GAP_M
_SPEED = 10.0
_ROOM_M = 0.3
_HAND_M = HAND_CLEARANCE_M - 0.02
"""Clearance of the hand minus the initial threshold."""
_LEEWAY_RAD = 0.2
_YAWS = 24


class Tuned(nn.Module):
    """Parameters with ten times the learning rate of weights."""

    start: Tensor

    def __init__(self, start: Sequence[Any]) -> None:
        """Set the initial values.

        Args:
            start: The values, nested as their shape is.
        """
        super().__init__()
        values = torch.tensor(start)
        self.register_buffer("start", values, persistent=False)
        # One-dimensional, because weight decay applies to more dimensions.
        self.change = nn.Parameter(torch.zeros(values.numel()))

    def forward(self) -> Tensor:
        """Return the present values."""
        return self.start + _SPEED * self.change.view_as(self.start)


class DragUtility(nn.Module):
    """Utility of drags: the paper's u = q - c, with soft thresholds."""

    def __init__(self, use_reach: bool = True) -> None:
        """Make the weights.

        Args:
            use_reach: Whether margins of reach count.
        """
        super().__init__()
        self.use_reach = use_reach
        self.candidates = DragCandidates()
        ahead, across = BAR_M
        self.ready_units = Tuned(
            [
                [(ahead + sign * _FIRST_GAP_M) / _READY_UNIT_M, across / _READY_UNIT_M]
                for sign in SIGNS
            ]
        )
        count = len(SIGNS)
        self.threshold = Tuned([list(_FIRST)] * count)
        self.sharpness = Tuned([[0.5] * len(_FIRST)] * count)
        self.enough = Tuned([4.0] * count)
        self.weights = Tuned([[0.0] * 3] * count)

    def ready(self, drag_m: Tensor) -> Tensor:
        """Return positions of objects in the gripper's frame when the stick is ready.

        Args:
            drag_m: Distance of each object's center from its contact with the stick,
                (...) [m].

        Returns:
            (S, ..., 2) [m].
        """
        learned = _READY_UNIT_M * self.ready_units()
        signs = constant(SIGNS, drag_m.device)
        extra = (1,) * drag_m.dim()
        ahead, across = learned.view(len(SIGNS), *extra, 2).unbind(-1)
        ahead = ahead + signs.view(-1, *extra) * drag_m
        return torch.stack([ahead, across.expand_as(ahead)], -1)

    def drags(self, table: SceneTable, cubes: Tensor | None = None) -> Drags:
        """Return the candidate drags.

        Args:
            table: B scenes.
            cubes: Numbers of the objects, (B, C); all movable ones if None.
        """
        if cubes is None:
            cubes = torch.arange(table.cargo, device=table.xy.device)
            cubes = cubes.expand(len(table), -1)
        ready = self.ready(table.traits.drag_m[cubes]).detach()
        return Drags(*self.candidates(table, cubes, ready))

    def forward(self, drags: Drags) -> Tensor:
        """Return the utility of drags, (B, R, S, C, T, L)."""
        return self._able(drags.constraints) + self._worth(drags.constraints)

    def values(self, drags: Drags) -> Tensor:
        """Return values of the best drag, (B, R, S, C, 3).

        Returns:
            Its utility, its log-feasibility (0 if surely feasible, otherwise negative),
            and the largest log-feasibility of all drags.
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
        scales = constant(_SCALES_M, constraints.device)
        soft = F.logsigmoid(sharp * (constraints / scales - threshold))
        if not self.use_reach:
            soft = soft[..., _OF_REACH:]
        return soft.sum(-1)

    def _worth(self, constraints: Tensor) -> Tensor:
        device = constraints.device
        enough = self.enough()[:, None, None, None]
        weights = self.weights().exp()[:, None, None, None]
        quality = torch.minimum(constraints[..., _RECEIVER] / _SCALE_M, enough)
        quality = quality * float(self.use_reach)
        length = constant(TRAVELS_M, device) / _SCALE_M
        turn = constant(TURNS_RAD, device).abs()[:, None]
        worth: Tensor = (
            weights[..., 0] * quality
            - weights[..., 1] * length
            - weights[..., 2] * 10 * turn
        )
        return worth


def _grid(half_x_m: float, half_y_m: float, step_m: float) -> Tensor:
    """Return the points of a grid around the origin, (N, 2) [m]."""
    columns, rows = round(half_x_m / step_m), round(half_y_m / step_m)
    # On the CPU, because torch loads its compiler for arithmetic on "meta".
    x = step_m * torch.arange(-columns, columns + 1, device="cpu")
    y = step_m * torch.arange(-rows, rows + 1, device="cpu")
    return torch.cartesian_prod(x, y).float()


class _Spots(nn.Module):
    """Utility of positions on a grid: soft thresholds and weighted features."""

    grid: Tensor

    def __init__(
        self, grid: Tensor, constraints: int, worths: int, use_reach: bool
    ) -> None:
        super().__init__()
        self.use_reach = use_reach
        self.register_buffer("grid", grid, persistent=False)
        self.threshold = Tuned([1.0] * constraints)
        self.sharpness = Tuned([0.5] * constraints)
        self.enough = Tuned([4.0] * 2)
        self.weights = Tuned([0.0] * worths)

    def _able(self, constraints: Tensor) -> Tensor:
        sharp = self.sharpness().exp()
        return F.logsigmoid(sharp * (constraints / _SCALE_M - self.threshold())).sum(-1)

    def _worst_margin(self, table: SceneTable, points: Tensor) -> Tensor:
        worst = table.margins(points.expand(len(table), -1, -1)).amin(1)
        return worst if self.use_reach else torch.zeros_like(worst)


class CubeSpots(_Spots):
    """Utility of positions for a cube."""

    def __init__(self, use_reach: bool = True) -> None:
        """Make the weights.

        Args:
            use_reach: Whether margins of reach count.
        """
        super().__init__(_grid(0.24, 0.44, 0.02), 3, 3, use_reach)

    def forward(self, table: SceneTable, cube: Tensor) -> Tensor:
        """Return the utility of each position, (B, N).

        Args:
            table: B scenes.
            cube: Number of the placed entity, (B,).
        """
        table = _without(table, cube)
        margin = self._worst_margin(table, self.grid)
        apart = torch.cdist(
            self.grid.expand(len(table), -1, -1), table.xy[:, : table.stick]
        )
        room = (apart - table.traits.disc_m[: table.stick]).amin(-1)
        stick = stick_distance(
            table.grasp[:, None], table.yaw[:, table.stick, None], self.grid
        )
        bases = torch.cdist(self.grid.expand(len(table), -1, -1), table.bases).amin(-1)
        room = torch.minimum(room, stick - HALF_M).clamp(max=_ROOM_M)
        able = self._able(torch.stack([margin, room, 0.2 * bases.clamp(max=1.0)], -1))
        weights, enough = self.weights().exp(), self.enough()
        utility: Tensor = (
            able
            + weights[0] * torch.minimum(margin / _SCALE_M, enough[0])
            + weights[1] * torch.minimum(room / _SCALE_M, enough[1])
            - weights[2] * self.grid.norm(dim=-1) / _SCALE_M
        )
        return utility

    def number(self, xy: Tensor) -> Tensor:
        """Return the indices of the candidates nearest to positions (B, 2) [m]."""
        return torch.cdist(xy, self.grid).argmin(-1)

    def pose(self, number: Tensor) -> Tensor:
        """Return the positions of candidates, (B, 2) [m]."""
        return self.grid[number]


class StickSpots(_Spots):
    """Utility of poses for the stick that every robot can grasp."""

    def __init__(self, use_reach: bool = True) -> None:
        """Make the weights.

        Args:
            use_reach: Whether margins of reach count.
        """
        super().__init__(_grid(0.16, 0.24, 0.04), 6, 3, use_reach)

    def forward(self, table: SceneTable, robot: Tensor) -> Tensor:
        """Return the utility of each position with each yaw, (B, N * yaws).

        Args:
            table: B scenes.
            robot: Number of the robot that brings it, (B,).
        """
        count, spots = len(table), len(self.grid)
        yaws = torch.arange(_YAWS, device=self.grid.device) * (math.tau / _YAWS)
        margin = self._worst_margin(table, self.grid)[..., None].expand(-1, -1, _YAWS)
        ray = self.grid[None, None] - table.bases[:, :, None]
        outward = torch.atan2(ray[..., 1], ray[..., 0])
        heading = torch.cos(yaws - outward[..., None]).clamp(-1, 1).acos().amax(1)
        own = outward[torch.arange(count, device=robot.device), robot]
        turn = self._turn(table, robot, yaws - own[..., None])
        grasps = self.grid.repeat_interleave(_YAWS, 0)[:, None]
        turned = yaws.repeat(spots)[:, None]
        things = table.xy[:, None, : table.stick]
        radii = table.traits.disc_m[: table.stick]
        room = stick_distance(grasps, turned, things) - radii
        hand = torch.cdist(self.grid.expand(count, -1, -1), table.xy[:, : table.stick])
        hand = (hand - radii).amin(-1).clamp(max=_ROOM_M)
        hand = hand[..., None].expand(-1, -1, _YAWS)
        bases = stick_distance(grasps, turned, table.bases[:, None]).amin(-1)
        room = room.amin(-1).clamp(max=_ROOM_M).view(count, spots, _YAWS)
        bases = bases.clamp(max=1.0).view(count, spots, _YAWS)
        able = self._able(
            torch.stack(
                [
                    *(margin, room, 0.2 * bases, 0.1 * (1.8 - heading)),
                    *(hand - _HAND_M, 0.1 * (LARGEST_TURN_RAD + _LEEWAY_RAD - turn)),
                ],
                -1,
            )
        )
        weights, enough = self.weights().exp(), self.enough()
        worth: Tensor = (
            weights[0] * torch.minimum(margin / _SCALE_M, enough[0])
            - weights[1] * (self.grid.norm(dim=-1, keepdim=True) / _SCALE_M)
            - weights[2] * heading * 10
        )
        return (able + worth).flatten(1)

    def _turn(self, table: SceneTable, robot: Tensor, heading: Tensor) -> Tensor:
        """Return the rotation of the stick relative to the robot's base, (B, N, yaws).

        The last joint rotates the stick, and cannot pass the direction towards the
        base, so the rotation may be the longer way [rad].

        Args:
            table: B scenes.
            robot: Number of the robot, (B,).
            heading: Heading of the placed stick from straight outward, (B, N, yaws).
        """
        rows = torch.arange(len(table), device=robot.device)
        ray = table.grasp - table.bases[rows, robot]
        outward = torch.atan2(ray[:, 1], ray[:, 0])
        before = wrapped(table.yaw[:, table.stick] - outward)
        return (wrapped(heading) - before[:, None, None]).abs()

    def number(self, pose: Tensor) -> Tensor:
        """Return the indices of the candidates nearest to gripper poses (B, 3)."""
        spot = torch.cdist(pose[:, :2], self.grid).argmin(-1)
        return spot * _YAWS + torch.round(pose[:, 2] * _YAWS / math.tau).long() % _YAWS

    def pose(self, number: Tensor) -> Tensor:
        """Return the gripper poses of candidates, (B, 3)."""
        yaw = (number % _YAWS).float() * (math.tau / _YAWS)
        return torch.cat([self.grid[number // _YAWS], yaw[:, None]], -1)


def _without(table: SceneTable, entity: Tensor) -> SceneTable:
    """Return scenes without an entity."""
    gone = F.one_hot(entity, table.xy.shape[1]).bool()
    return replace(table, xy=torch.where(gone.unsqueeze(-1), FAR_M, table.xy))
