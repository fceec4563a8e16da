"""ReachNet's tables: what is known of a scene, as a few small vectors.

Everything behind perception works on tables. They come from images, or in training
also from the labels, with noise: then the planner sees many variants of every frame for
the price of a few vectors. The stick is axes around which it lies, as its record says.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import torch
from torch import Tensor

from lemma.core.arguments import Deviation, Share
from lemma.core.poses import Pose2
from lemma.policies.batch import NOBODY, Labels
from lemma.policies.entities import BENCHMARK, EntitySet, Traits, traits_of
from lemma.policies.interfaces import SeenObject, SeenRobot
from lemma.scene.objects.kind import Part
from lemma.scene.objects.stick import STICK_KIND
from lemma.scene.raster import RASTER, Raster

COLUMNS = 128
"""Number of columns of a table's :attr:`SceneTable.ground`."""
CONJUNCTS = 2
"""Largest number of (top, bottom) pairs of a goal."""
FAR_M = 10.0
"""Where things are that are not there."""

_ABOVE_M = 0.005
_LEAST_RAD = 1e-3
_GRASP = STICK_KIND.grasp
assert _GRASP is not None
GRASP_M = _GRASP.at.x
"""Where the stick is grasped, along its own x axis from its frame [m]."""
HALF_M = STICK_KIND.disc_m
"""From its axes to its sides [m]."""


def _axis(part: Part) -> tuple[float, float, float, float]:
    """Return the ends of the axis of a part that lies, seen from the gripper.

    It runs from face to face, so that what is kept clear of it is clear of the ends.
    """
    assert _GRASP is not None
    half = (0.0, 0.0)
    if part.shape == "box":
        x, y, _ = part.size_m
        half = (x, 0.0) if x > y else (0.0, y)
    middle = _GRASP.at.inverse() @ Pose2(*part.position_m[:2])
    low, high = (middle @ Pose2(side * half[0], side * half[1]) for side in (-1, 1))
    return low.x, low.y, high.x, high.y


AXES_M = tuple(map(_axis, STICK_KIND.parts))
"""Ends u, v, u, v of each part's axis, seen from the gripper that holds the stick
[m]."""
_BAR = max(AXES_M, key=lambda axis: axis[0] + axis[2])
BAR_M = (0.5 * (_BAR[0] + _BAR[2]), 0.5 * (_BAR[1] + _BAR[3]))
"""Middle of the part that is farthest out, with which things are moved [m]."""
FAR_END_M = max(0.0, *(max(u, v) for u, _, v, _ in AXES_M)) + GRASP_M
"""A point on the stick's x axis, as far out as it goes, seen from its frame: it shows
how the stick lies [m]."""


@dataclass(frozen=True, eq=False)
class SceneTable:
    """State of B scenes with R robots; tensors on one device, float32.

    Of E entities the first C are there to be moved, and the last is the stick.
    """

    present: Tensor
    """Which entities are seen, (B, E) bool. Covered ones are not."""
    xy: Tensor
    """Positions [m], (B, E, 2); ``FAR_M`` where nothing is seen."""
    yaw: Tensor
    """(B, E) [rad]: of what is moved, :func:`folded`; the stick's; else 0."""
    top: Tensor
    """Height of the upper face of what is moved [m], (B, E); 0 for the rest."""
    bases: Tensor
    """Positions of the robots' bases [m], (B, R, 2)."""
    radii: Tensor
    """Radii between which each robot works, and up to which it holds things low, as at
    the end of a drag [m], (B, R, 3): inner, outer, low."""
    ground: Tensor
    """Whether there is a table, 0 to 1, along x from one edge of the map to the other,
    (B, COLUMNS): it may have a gap, as deep as the table."""
    half_x_m: float = RASTER.size_m[0] / 2
    """From the middle of the map to these edges."""
    entities: EntitySet = BENCHMARK
    """Entities with a number."""

    @property
    def cargo(self) -> int:
        """C: how many entities are there to be moved; they come first."""
        return self.entities.cargo

    @property
    def stick(self) -> int:
        """Number of the stick."""
        return self.entities.stick

    @property
    def traits(self) -> Traits:
        """Properties of the entities' kinds."""
        return traits_of(self.entities, self.xy.device)

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self.xy)

    @property
    def grasp(self) -> Tensor:
        """Where the stick is grasped [m], (B, 2)."""
        yaw = self.yaw[:, self.stick]
        along = torch.stack([yaw.cos(), yaw.sin()], -1)
        return self.xy[:, self.stick] + GRASP_M * along

    def margins(self, points: Tensor, *, low: bool = False) -> Tensor:
        """Return how far inside each robot's reach points are [m], (B, R, ...).

        Args:
            points: (B, ..., 2) [m].
            low: Whether it is enough to hold something low there.
        """
        extra = (1,) * (points.dim() - 2)
        bases = self.bases.view(len(self), -1, *extra, 2)
        inner, outer, lowest = self.radii.view(len(self), -1, *extra, 3).unbind(-1)
        distance = (points.unsqueeze(1) - bases).norm(dim=-1)
        return torch.minimum(distance - inner, (lowest if low else outer) - distance)

    def table_at(self, x: Tensor) -> Tensor:
        """Return whether there is a table at positions, 0 to 1, (B, ...).

        Args:
            x: World x, (B, ...) [m].
        """
        share = (0.5 + 0.5 * x / self.half_x_m).clamp(0.0, 1.0) * (COLUMNS - 1)
        index = share.floor().long().clamp(max=COLUMNS - 2).flatten(1)
        rest = share.flatten(1) - index
        near, far = self.ground.gather(1, index), self.ground.gather(1, index + 1)
        return (near + rest * (far - near)).view_as(x)

    def seen(self, row: int) -> tuple[tuple[SeenObject, ...], tuple[SeenRobot, ...]]:
        """Return what is known of one scene as plain data."""
        named = zip(self.entities.places, self.xy[row].tolist(), strict=False)
        there = self.present[row].tolist()
        objects = (
            SeenObject(name, (x, y))
            for (name, (x, y)), seen in zip(named, there, strict=True)
            if seen
        )
        bases = zip(self.bases[row].tolist(), self.radii[row].tolist(), strict=True)
        robots = (SeenRobot((x, y), (r[0], r[1])) for (x, y), r in bases)
        return tuple(objects), tuple(robots)

    def rows(self, index: Tensor) -> Self:
        """Return some of the scenes."""
        return replace(self, **{name: getattr(self, name)[index] for name in _TENSORS})

    def detached(self) -> Self:
        """Return the same without gradients."""
        return replace(self, **{n: getattr(self, n).detach() for n in _TENSORS})

    @classmethod
    def joined(cls, tables: "list[SceneTable]") -> "SceneTable":
        """Return all scenes of some tables."""
        parts: dict[str, Any] = {
            name: torch.cat([getattr(t, name) for t in tables]) for name in _TENSORS
        }
        return replace(tables[0], **parts)


_TENSORS = tuple(f.name for f in fields(SceneTable) if f.type is Tensor)


def ground_of(gap_m: Tensor, half_x_m: float) -> Tensor:
    """Return where there is a table, (B, COLUMNS).

    Args:
        gap_m: World x from and to which there is none, (B, 2) [m]; NaN if it is whole.
        half_x_m: From the middle of the map to its edges.
    """
    x = torch.linspace(-half_x_m, half_x_m, COLUMNS, device=gap_m.device)
    first, last = gap_m.unsqueeze(1).unbind(-1)
    return 1.0 - ((x > first) & (x < last)).float()


def yaw_of(quaternion: Tensor) -> Tensor:
    """Return the rotation about the vertical of quaternions wxyz, (...) [rad]."""
    w, x, y, z = quaternion.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def folded(yaw: Tensor, turn_rad: Tensor | float) -> Tensor:
    """Return yaws as near to zero as turns that change nothing bring them.

    Args:
        yaw: [rad], (..., N).
        turn_rad: The least such turn of each, (N,) [rad]; 0 where any is one.
    """
    turn = torch.as_tensor(turn_rad, device=yaw.device)
    near = yaw - turn * torch.round(yaw / turn.clamp(min=_LEAST_RAD))
    return torch.where(turn > 0.0, near, 0.0)


def true_table(
    labels: Labels, radii: Tensor, raster: Raster, entities: EntitySet = BENCHMARK
) -> SceneTable:
    """Return the table of perfect perception.

    Args:
        labels: Where everything is.
        radii: Radii of reach, (B, R, 3) [m].
        raster: Raster of the maps.
        entities: Entities whose numbers the labels have.
    """
    traits = traits_of(entities, labels.objects.device)
    position, there = labels.objects[..., :3], labels.objects[..., 0].isfinite()
    xyz = torch.where(there.unsqueeze(-1), position, FAR_M)
    top_m = xyz[..., 2] + traits.top_m
    present = there & ~_covered(xyz, top_m, traits, entities.cargo)
    turned = yaw_of(labels.objects[..., 3:])
    yaw = torch.zeros_like(turned)
    cubes, stick = slice(0, entities.cargo), entities.stick
    yaw[:, cubes] = folded(turned[:, cubes], traits.turn_rad[cubes])
    yaw[:, stick] = turned[:, stick]
    top = torch.zeros_like(yaw)
    top[:, cubes] = top_m[:, cubes]
    return SceneTable(
        present=present,
        xy=torch.where(present.unsqueeze(-1), xyz[..., :2], FAR_M),
        yaw=torch.where(present, yaw, 0.0),
        top=torch.where(present, top, 0.0),
        bases=labels.bases[..., :2],
        radii=radii,
        ground=ground_of(labels.gap_m, raster.size_m[0] / 2),
        half_x_m=raster.size_m[0] / 2,
        entities=entities,
    )


def _covered(xyz: Tensor, top_m: Tensor, traits: Traits, cargo: int) -> Tensor:
    """Return which entities lie under one that can be moved, (B, E)."""
    upper = xyz[:, :cargo]
    apart = (xyz[:, :, None, :2] - upper[:, None, :, :2]).norm(dim=-1)
    bottom_m = (top_m - traits.height_m)[:, :cargo]
    over = bottom_m[:, None] > top_m[:, :, None] - _ABOVE_M
    covered: Tensor = ((apart < traits.support_m[:, None]) & over).any(-1)
    return covered


@dataclass(frozen=True)
class Noise:
    """How far tables in training differ from the truth, as perception errs."""

    position_m: Deviation = 0.003
    """Standard deviation of positions."""
    yaw_rad: Deviation = 0.02
    """Standard deviation of yaws."""
    height_m: Deviation = 0.003
    """Standard deviation of heights."""
    base_m: Deviation = 0.004
    """Standard deviation of bases and of radii of reach."""
    unseen: Share = 0.01
    """Share of entities that the sub-task does not need and that are missed."""


def disturbed(table: SceneTable, noise: Noise, needed: Tensor) -> SceneTable:
    """Return a table with the errors of perception.

    Args:
        table: The truth.
        noise: How much it errs.
        needed: Entities that are never missed, (B, E) bool.
    """

    def jitter(values: Tensor, deviation: float) -> Tensor:
        return values + deviation * torch.randn_like(values)

    missed = (torch.rand_like(table.yaw) < noise.unseen) & ~needed
    present = table.present & ~missed
    xy = jitter(table.xy, noise.position_m)
    return replace(
        table,
        present=present,
        xy=torch.where(present.unsqueeze(-1), xy, FAR_M),
        yaw=torch.where(present, jitter(table.yaw, noise.yaw_rad), 0.0),
        top=torch.where(present, jitter(table.top, noise.height_m), 0.0),
        bases=jitter(table.bases, noise.base_m),
        radii=jitter(table.radii, noise.base_m),
    )


def turned(table: SceneTable) -> SceneTable:
    """Return the table turned by half a turn, with the robots in reverse order.

    Sub-tasks turn with :func:`turned_numbers`.
    """
    yaw = table.yaw.clone()
    yaw[:, table.stick] += math.pi
    return replace(
        table,
        xy=torch.where(table.present.unsqueeze(-1), -table.xy, FAR_M),
        yaw=yaw,
        bases=-table.bases.flip(1),
        radii=table.radii.flip(1),
        ground=table.ground.flip(1),
    )


def turned_numbers(decisions: Tensor, robots: int) -> Tensor:
    """Return sub-tasks (..., 4) with the robots in reverse order."""
    robot = decisions[..., :1]
    flipped = torch.where(robot == NOBODY, robot, robots - 1 - robot)
    return torch.cat([flipped, decisions[..., 1:]], -1)


def needed_entities(decision: Tensor, goal: Tensor, count: int) -> Tensor:
    """Return the entities that sub-tasks and goals name, and the stick, (B, E) bool.

    Args:
        decision: (B, 4) int64.
        goal: (B, conjuncts, 2) int64; -1 for none.
        count: E.
    """
    named = torch.cat([decision[:, 2:], goal.flatten(1)], 1)
    named = torch.where((named < 0) | (named >= count), count, named)
    hot = torch.zeros(len(decision), count + 1, device=decision.device)
    hot.scatter_(1, named, 1.0)
    hot[:, count - 1].fill_(1.0)
    return hot[:, :count] > 0


def stick_distance(grasp: Tensor, yaw: Tensor, points: Tensor) -> Tensor:
    """Return the distance of points from the axes of lying sticks [m], (...).

    Args:
        grasp: Where the stick is grasped, (..., 2) [m].
        yaw: Yaw of the stick, (...) [rad].
        points: (..., 2) [m].
    """
    x, y = (points - grasp).unbind(-1)
    u, v = x * yaw.cos() + y * yaw.sin(), y * yaw.cos() - x * yaw.sin()
    return swept_distance(u, v, torch.zeros_like(u), torch.zeros_like(u))


def swept_distance(u: Tensor, v: Tensor, back: Tensor, forth: Tensor) -> Tensor:
    """Return the distance of points from all that a stick's axes pass over [m].

    Axes that run along the stick or across it, as those of the benchmark's do, are
    followed exactly; of others, the rectangle around them.

    Args:
        u: Coordinate of the points, ahead of the gripper when the motion begins [m].
        v: To its left [m].
        back: How far the stick moves back, at most 0 [m].
        forth: How far it moves ahead, at least 0 [m].
    """
    found = []
    for first_u, first_v, last_u, last_v in AXES_M:
        low, high = sorted((first_u, last_u))
        along = beyond(u, low + back, high + forth)
        left, right = sorted((first_v, last_v))
        found.append(along.hypot((v - v.clamp(left, right)).abs()))
    return torch.stack(found).amin(0)


def beyond(x: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return the distance of numbers from an interval."""
    return torch.maximum(low - x, x - high).clamp(min=0.0)
