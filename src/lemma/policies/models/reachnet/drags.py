"""Candidate drags of objects with the stick, and the constraints on each of them.

The candidates are a few bearings and lengths. The constraints are computed from
perception: margins of gripper and object inside the estimated reach, and clearance from
obstacles.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.layers import Network, constant
from lemma.policies.models.reachnet.scene_table import (
    SceneTable,
    beyond,
    swept_distance,
)
from lemma.tasks.drags import MAX_DRAG_M, PREPARE_GAP_M

SIGNS = (-1.0, 1.0)
"""Direction of the cube's motion along the stick, for hook and for poke."""
TURNS_RAD = tuple(
    math.radians(d) for d in (-54, -42, -32, -24, -16, -8, 0, 8, 16, 24, 32, 42, 54)
)
"""Candidate bearings of the stick, relative to the cube's bearing from the robot."""
_SHORTEST_M, _STEP_M = 0.12, 0.02
TRAVELS_M = tuple(
    round(_SHORTEST_M + _STEP_M * i, 3)
    for i in range(1 + round((MAX_DRAG_M + PREPARE_GAP_M - _SHORTEST_M) / _STEP_M))
)
"""Candidate distances of the gripper's motion."""
_WITHDRAWN_M = ((0.03,), (0.03, 0.09, 0.15))
"""Motions that free the stick from the object after hook, outward, and poke, back."""
_ON_TABLE = tuple(torch.linspace(0.0, 1.0, 6).tolist())
"""Shares of a drag after which the object must be on a table."""
_MOST_M = 1.0


@dataclass(frozen=True, eq=False)
class Drags:
    """All drags of C objects: T bearings, L lengths, S primitives, R robots."""

    constraints: Tensor
    """Values that must exceed thresholds, (B, R, S, C, T, L, 9): reach margins of the
    gripper at both ends, of the cube's end, and of the gripper when the stick is freed;
    clearance of the stick, the cube and the hand, and from bases [m]; and the
    probability of a table under the cube."""
    bearings: Tensor
    """Bearings of the stick [rad], (B, R, S, C, T)."""
    prepared: Tensor
    """Gripper's position where it puts the stick down, (B, R, S, C, T, 2) [m]."""


class DragCandidates(Network):
    """Computes candidates: a network without weights, of many short operations."""

    def forward(
        self, table: SceneTable, cubes: Tensor, ready: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the fields of :class:`Drags`.

        Args:
            table: B scenes.
            cubes: Numbers of the objects, (B, C).
            ready: Where each is when the stick is ready, (S, B, C, 2) [m].
        """
        cube = table.xy.gather(1, cubes[..., None].expand(-1, -1, 2))
        turns = constant(TURNS_RAD, cube.device)
        bearings = straight(table, cube).unsqueeze(-1) + turns
        ahead = torch.stack([bearings.cos(), bearings.sin()], -1)
        left = torch.stack([-ahead[..., 1], ahead[..., 0]], -1)
        ready = ready.movedim(0, 1)[:, None, :, :, None]
        at = cube[:, None, None, :, None]
        prepared = at - ready[..., :1] * ahead - ready[..., 1:] * left
        signs = constant(SIGNS, cube.device)[:, None, None, None, None]
        travel = constant(TRAVELS_M, cube.device)[:, None]
        moves = signs * ahead.unsqueeze(-2) * travel
        end = prepared.unsqueeze(-2) + moves
        moved = moves * (1 - PREPARE_GAP_M / travel)
        cube_end = at.unsqueeze(-2) + moved
        parts = [
            _own(table.margins(prepared)).unsqueeze(-1).expand(end.shape[:-1]),
            _own(table.margins(end, low=True)),
            _receiver(table.margins(cube_end)),
            _freed(table, end, ahead),
            *_room(table, cubes, (prepared, ahead, left), ready),
            torch.stack(
                [
                    table.table_at((at.unsqueeze(-2) + step * moved)[..., 0])
                    for step in _ON_TABLE
                ]
            ).amin(0),
        ]
        return torch.stack(parts, -1), bearings, prepared


def _room(
    table: SceneTable,
    cubes: Tensor,
    lying: tuple[Tensor, Tensor, Tensor],
    ready: Tensor,
) -> list[Tensor]:
    """Return clearances of stick, cube, hand and from bases, (B, R, S, C, T, L) each.

    Args:
        table: B scenes.
        cubes: Numbers of the objects, (B, C).
        lying: Gripper's position where it puts the stick down, and the directions ahead
            of it and to its left, (B, R, S, C, T, 2) each.
        ready: The object's position in that frame, (B, 1, S, C, 1, 2).
    """
    prepared, ahead, left = lying
    device, stick_number = table.xy.device, table.stick
    things = torch.cat([table.xy[:, :stick_number], table.bases], 1)
    radii = F.pad(table.traits.disc_m[:stick_number], (0, table.bases.shape[1]))
    offset = things[:, None, None, None, None] - prepared.unsqueeze(-2)
    u = (offset * ahead.unsqueeze(-2)).sum(-1)[..., None, :]
    v = (offset * left.unsqueeze(-2)).sum(-1)[..., None, :]
    signs = constant(SIGNS, device)[:, None, None, None, None]
    travel = constant(TRAVELS_M, device)[:, None] * signs
    back, forth = travel.clamp(max=0.0), travel.clamp(min=0.0)
    stick = swept_distance(u, v, back, forth) - radii
    moved = travel - signs * PREPARE_GAP_M
    start = ready[..., 0, None, None]
    path = beyond(u, start + moved.clamp(max=0), start + moved.clamp(min=0))
    cube = path.hypot(v - ready[..., 1, None, None]) - radii
    own = F.one_hot(cubes, things.shape[1]).bool()[:, None, None, :, None, None]
    stick = torch.where(own, _MOST_M, stick)
    cube = torch.where(own, _MOST_M, cube)
    bases = torch.minimum(stick, cube)[..., stick_number:].amin(-1)
    # The dragged object is at the end of the stick, far from the hand.
    hand = beyond(u, back, forth).hypot(v) - radii
    rooms = (stick, cube, torch.where(own, _MOST_M, hand))
    found = [room[..., :stick_number].amin(-1) for room in rooms]
    # Larger clearances make no difference.
    return [room.clamp(max=_MOST_M) for room in (*found, bases)]


def straight(table: SceneTable, points: Tensor) -> Tensor:
    """Return the straight bearings of drags, (B, R, S, N) [rad].

    For hook it is from the robot's base to the object, for poke from the object to the
    nearest other base.

    Args:
        table: B scenes.
        points: World positions of objects, (B, N, 2) [m].
    """
    away = points[:, None] - table.bases[:, :, None]
    robots = away.shape[1]
    hooked = torch.atan2(away[..., 1], away[..., 0])
    far = away.norm(dim=-1)[:, None].expand(-1, robots, -1, -1)
    itself = torch.eye(robots, dtype=torch.bool, device=points.device)
    nearest = far.masked_fill(itself[..., None], torch.inf).argmin(2)
    to = -away.gather(1, nearest[..., None].expand_as(away))
    return torch.stack([hooked, torch.atan2(to[..., 1], to[..., 0])], 2)


def _freed(table: SceneTable, end: Tensor, ahead: Tensor) -> Tensor:
    """Return each robot's margin where it frees the stick, (B, R, S, C, T, L) [m].

    Args:
        table: B scenes.
        end: Gripper's position at the end of a drag, (B, R, S, C, T, L, 2) [m].
        ahead: Direction of the stick, (B, R, S, C, T, 2).
    """
    found = []
    for side, (sign, ways) in enumerate(zip(SIGNS, _WITHDRAWN_M, strict=True)):
        step = -sign * ahead[:, :, side].unsqueeze(-2)
        margins = [_own(table.margins(end[:, :, side] + way * step)) for way in ways]
        found.append(torch.stack(margins).amax(0))
    return torch.stack(found, 2)


def _own(margins: Tensor) -> Tensor:
    """Return each robot's margin of its own points, (B, R, ...).

    Args:
        margins: Margins of every robot at the points of every robot, (B, R, R, ...).
    """
    return torch.stack([margins[:, i, i] for i in range(margins.shape[1])], 1)


def _receiver(margins: Tensor) -> Tensor:
    """Return the receiving robot's margin at the cube's end, (B, R, S, ...).

    The receiver is the same robot after hook, and another one after poke.
    """
    robots = margins.shape[1]
    rows = []
    for i in range(robots):
        others = [margins[:, j, i, 1] for j in range(robots) if j != i]
        best_other = torch.stack(others).amax(0)
        rows.append(torch.stack([margins[:, i, i, 0], best_other], 1))
    return torch.stack(rows, 1)
