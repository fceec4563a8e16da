"""ReachNet's free spots: where to put a cube or the stick down for somebody else.

As with drags, a spot is one of many candidates, and its utility is learned.
"""

import math
from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.models.reachnet.drags import Tuned
from lemma.policies.models.reachnet.scene_table import FAR_M, SceneTable
from lemma.policies.models.reachnet.tool_shape import HALF_M, stick_distance
from lemma.tasks.drags import HAND_CLEARANCE_M, LARGEST_TURN_RAD

_SCALE_M = 0.02
_ROOM_M = 0.3
_HAND_M = HAND_CLEARANCE_M - 0.02
"""Less than a hand needs by what a threshold is at first."""
_LEEWAY_RAD = 0.2
_YAWS = 24


def _grid(half_x_m: float, half_y_m: float, step_m: float) -> Tensor:
    """Return the points of a grid around the origin, (N, 2) [m]."""
    columns, rows = round(half_x_m / step_m), round(half_y_m / step_m)
    # On "meta", torch would load its compiler for this.
    x = step_m * torch.arange(-columns, columns + 1, device="cpu")
    y = step_m * torch.arange(-rows, rows + 1, device="cpu")
    return torch.cartesian_prod(x, y).float()


class _Spots(nn.Module):
    """Utility of candidates: soft thresholds, and what is better or worse."""

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
    """Predicts the place for a cube."""

    def __init__(self, use_reach: bool = True) -> None:
        """Make the weights.

        Args:
            use_reach: Whether margins of reach count.
        """
        super().__init__(_grid(0.24, 0.44, 0.02), 3, 3, use_reach)

    def forward(self, table: SceneTable, cube: Tensor) -> Tensor:
        """Return the utility of each spot, (B, N).

        Args:
            table: B scenes.
            cube: Which entity is put there, (B,).
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
        """Return the spot nearest to positions (B, 2) [m]."""
        return torch.cdist(xy, self.grid).argmin(-1)

    def pose(self, number: Tensor) -> Tensor:
        """Return the positions of spots, (B, 2) [m]."""
        return self.grid[number]


class StickSpots(_Spots):
    """How to lay the stick down so that every robot can take it."""

    def __init__(self, use_reach: bool = True) -> None:
        """Make the weights.

        Args:
            use_reach: Whether margins of reach count.
        """
        super().__init__(_grid(0.16, 0.24, 0.04), 6, 3, use_reach)

    def forward(self, table: SceneTable, robot: Tensor) -> Tensor:
        """Return the utility of each spot with each yaw, (B, N * yaws).

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
        away = self.grid.norm(dim=-1, keepdim=True) / _SCALE_M
        worth = (
            weights[0] * torch.minimum(margin / _SCALE_M, enough[0])
            - weights[1] * away
            - weights[2] * heading * 10
        )
        utility: Tensor = (able + worth).flatten(1)
        return utility

    def _turn(self, table: SceneTable, robot: Tensor, heading: Tensor) -> Tensor:
        """Return how far the stick turns, seen from the base of who brings it.

        The last joint turns it, and never beyond straight back to the base: from one
        side of that to the other it goes the long way.

        Args:
            table: B scenes.
            robot: (B,).
            heading: Heading of the laid stick, from straight outward, (B, N, yaws).
        """
        rows = torch.arange(len(table), device=robot.device)
        ray = table.grasp - table.bases[rows, robot]
        outward = torch.atan2(ray[:, 1], ray[:, 0])
        before = _wrapped(table.yaw[:, table.stick] - outward)
        return (_wrapped(heading) - before[:, None, None]).abs()

    def number(self, pose: Tensor) -> Tensor:
        """Return the candidates nearest to gripper poses (B, 3)."""
        spot = torch.cdist(pose[:, :2], self.grid).argmin(-1)
        return spot * _YAWS + torch.round(pose[:, 2] * _YAWS / math.tau).long() % _YAWS

    def pose(self, number: Tensor) -> Tensor:
        """Return the gripper poses of candidates, (B, 3)."""
        yaw = (number % _YAWS).float() * (math.tau / _YAWS)
        return torch.cat([self.grid[number // _YAWS], yaw[:, None]], -1)


def _wrapped(angle: Tensor) -> Tensor:
    """Return angles [rad] in [-pi, pi)."""
    return torch.remainder(angle + math.pi, math.tau) - math.pi


def _without(table: SceneTable, entity: Tensor) -> SceneTable:
    """Return the table with an entity taken away."""
    gone = F.one_hot(entity, table.xy.shape[1]).bool()
    return replace(table, xy=torch.where(gone.unsqueeze(-1), FAR_M, table.xy))
