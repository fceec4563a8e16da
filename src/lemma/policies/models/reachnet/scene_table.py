"""ReachNet's scene tables: the state of a scene as a few small vectors.

All modules after perception work on scene tables. They come from images or, in
training, also from labels with noise, so the planner trains on many cheap variants of
every frame. The stick is represented by the axes of its parts.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import torch
from torch import Tensor

from lemma.core.poses import Pose2
from lemma.policies.batch import NOBODY, Labels
from lemma.policies.entities import BENCHMARK, EntitySet, Traits, traits_of
from lemma.policies.interfaces import SeenObject, SeenRobot
from lemma.policies.layers import constant
from lemma.scene.objects.kind import Part
from lemma.scene.objects.stick import STICK_KIND
from lemma.scene.raster import RASTER, Raster

COLUMNS = 128
"""Number of columns of :attr:`SceneTable.ground`."""
CONJUNCTS = 2
"""Largest number of (top, bottom) pairs of a goal."""
FAR_M = 10.0
"""Coordinate of absent entities [m]."""

_ABOVE_M = 0.005
_LEAST_RAD = 1e-3
_GRASP = STICK_KIND.grasp
assert _GRASP is not None
GRASP_M = _GRASP.at.x
"""Position of the stick's grasp along its own x axis [m]."""
HALF_M = STICK_KIND.disc_m
"""Distance of the stick's axes from its sides [m]."""


def _axis(part: Part) -> tuple[float, float, float, float]:
    """Return the ends of the axis of a lying part, in the gripper's frame [m].

    The axis extends to the faces at both ends, so that clearance from it is clearance
    from the part.
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
"""Ends u, v, u, v of each part's axis, in the frame of the gripper that holds the stick
[m]."""
_BAR = max(AXES_M, key=lambda axis: axis[0] + axis[2])
BAR_M = (0.5 * (_BAR[0] + _BAR[2]), 0.5 * (_BAR[1] + _BAR[3]))
"""Center of the outermost part, which drags objects, in the gripper's frame [m]."""
HEADING_M = 0.6
"""Position of a point on the stick's x axis [m], which perception predicts to get the
yaw. The far end, at 0.75 m, is off the map when it hooks a cube at the edge."""


@dataclass(frozen=True, eq=False)
class SceneTable:
    """State of B scenes with R robots in the world frame; float32 on one device.

    Of E entities the first C are movable, and the last is the stick.
    """

    present: Tensor
    """Whether entities are seen, (B, E) bool; covered ones are not."""
    xy: Tensor
    """Positions [m], (B, E, 2); ``FAR_M`` for entities that are not seen."""
    yaw: Tensor
    """Yaws [rad], (B, E): :func:`folded` for movable entities; 0 for fixed ones."""
    top: Tensor
    """Height of the top of movable entities [m], (B, E); 0 for the rest."""
    bases: Tensor
    """Positions of the robots' bases [m], (B, R, 2)."""
    radii: Tensor
    """Radii of each robot's reach [m], (B, R, 3): inner, outer, and outer for an object
    that is held low, as at the end of a drag."""
    ground: Tensor
    """Whether there is a table, 0 to 1, at positions along x from one edge of the map
    to the other, (B, COLUMNS). The table may have a gap over its whole depth."""
    half_x_m: float = RASTER.size_m[0] / 2
    """Distance from the center of the map to these edges [m]."""
    entities: EntitySet = BENCHMARK
    """Entities, in the order of their numbers."""

    @property
    def cargo(self) -> int:
        """C: number of movable entities; they come first."""
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
        """Grasp position of the stick [m], (B, 2)."""
        yaw = self.yaw[:, self.stick]
        along = torch.stack([yaw.cos(), yaw.sin()], -1)
        return self.xy[:, self.stick] + GRASP_M * along

    def margins(self, points: Tensor, *, low: bool = False) -> Tensor:
        """Return the margins of points inside each robot's reach [m], (B, R, ...).

        Args:
            points: World positions, (B, ..., 2) [m].
            low: Whether to use the outer radius for low objects.
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
        """Return one scene as plain data."""
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

    def showing(self, present: Tensor) -> Self:
        """Return the scenes with some entities only, (B, E) bool."""
        return replace(
            self,
            present=present,
            xy=torch.where(present[..., None], self.xy, FAR_M),
            yaw=torch.where(present, self.yaw, 0.0),
            top=torch.where(present, self.top, 0.0),
        )

    def rows(self, index: Tensor) -> Self:
        """Return some of the scenes."""
        return replace(self, **{name: getattr(self, name)[index] for name in _TENSORS})

    def detached(self) -> Self:
        """Return the scenes without gradients."""
        return replace(self, **{n: getattr(self, n).detach() for n in _TENSORS})

    @classmethod
    def joined(cls, tables: "list[SceneTable]") -> "SceneTable":
        """Concatenate scene tables."""
        parts: dict[str, Any] = {
            name: torch.cat([getattr(t, name) for t in tables]) for name in _TENSORS
        }
        return replace(tables[0], **parts)


_TENSORS = tuple(f.name for f in fields(SceneTable) if f.type is Tensor)


def ground_of(gap_m: Tensor, half_x_m: float) -> Tensor:
    """Return whether there is a table at positions along x, (B, COLUMNS).

    Args:
        gap_m: World x of both edges of the gap, (B, 2) [m]; NaN without a gap.
        half_x_m: Distance from the center of the map to its edges [m].
    """
    x = torch.linspace(-half_x_m, half_x_m, COLUMNS, device=gap_m.device)
    first, last = gap_m.unsqueeze(1).unbind(-1)
    return 1.0 - ((x > first) & (x < last)).float()


def yaw_of(quaternion: Tensor) -> Tensor:
    """Return the rotation about the vertical of quaternions wxyz, (...) [rad]."""
    w, x, y, z = quaternion.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def folded(yaw: Tensor, turn_rad: Tensor | float) -> Tensor:
    """Return the equivalent yaws nearest to zero under rotational symmetry.

    Args:
        yaw: [rad], (..., N).
        turn_rad: Smallest symmetric turn of each, (N,) [rad]; 0 for full symmetry.
    """
    turn = torch.as_tensor(turn_rad, device=yaw.device)
    near = yaw - turn * torch.round(yaw / turn.clamp(min=_LEAST_RAD))
    return torch.where(turn > 0.0, near, 0.0)


def true_radii(arms: Tensor, device: torch.device) -> Tensor:
    """Return the true radii of arms, (B, R, 3) [m].

    Args:
        arms: Numbers of the arm types, (B, R).
        device: Device of the result.
    """
    # A late import, because inference does not need the simulator.
    from lemma.robots.reach import reach_of  # noqa: PLC0415
    from lemma.robots.ur.arms import ARMS  # noqa: PLC0415

    found = [reach_of(name) for name in ARMS]
    radii = tuple((r.inner_m, r.travel_m, r.grasp_m) for r in found)
    return constant(radii, device)[arms]


def true_table(
    labels: Labels, radii: Tensor, raster: Raster, entities: EntitySet = BENCHMARK
) -> SceneTable:
    """Return the scene tables of perfect perception.

    Args:
        labels: Labels with the true poses.
        radii: Radii of reach, (B, R, 3) [m].
        raster: Raster of the maps.
        entities: Entities, in the order of their numbers.
    """
    traits = traits_of(entities, labels.objects.device)
    position, there = labels.objects[..., :3], labels.objects[..., 0].isfinite()
    xyz = torch.where(there.unsqueeze(-1), position, FAR_M)
    top_m = xyz[..., 2] + traits.top_m
    present = there & ~covered(xyz, top_m, traits, entities.cargo)
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


def covered(xyz: Tensor, top_m: Tensor, traits: Traits, cargo: int) -> Tensor:
    """Return whether a movable entity covers each entity, (B, E) bool."""
    upper = xyz[:, :cargo]
    apart = (xyz[:, :, None, :2] - upper[:, None, :, :2]).norm(dim=-1)
    bottom_m = (top_m - traits.height_m)[:, :cargo]
    over = bottom_m[:, None] > top_m[:, :, None] - _ABOVE_M
    covered: Tensor = ((apart < traits.support_m[:, None]) & over).any(-1)
    return covered


def turned(table: SceneTable) -> SceneTable:
    """Return scenes turned by half a turn, with the robots in reverse order.

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
    """Return the mask of the entities in sub-tasks and goals and the stick, (B, E).

    Args:
        decision: (B, 4) int64.
        goal: (B, conjuncts, 2) int64; -1 for none.
        count: E.
    """
    needed = numbered(torch.cat([decision[:, 2:], goal.flatten(1)], 1), count)
    needed[:, count - 1].fill_(True)
    return needed


def numbered(numbers: Tensor, count: int) -> Tensor:
    """Return the mask of the entities with some numbers, (B, N) to (B, E).

    Args:
        numbers: (B, N) int64; others than those of entities count for nothing.
        count: E.
    """
    inside = torch.where((numbers < 0) | (numbers >= count), count, numbers)
    hot = torch.zeros(len(numbers), count + 1, device=numbers.device)
    return hot.scatter_(1, inside, 1.0)[:, :count] > 0


def stick_distance(grasp: Tensor, yaw: Tensor, points: Tensor) -> Tensor:
    """Return the distance of points from the axes of lying sticks [m], (...).

    Args:
        grasp: Grasp positions of the sticks, (..., 2) [m].
        yaw: Yaws of the sticks, (...) [rad].
        points: World positions, (..., 2) [m].
    """
    x, y = (points - grasp).unbind(-1)
    u, v = x * yaw.cos() + y * yaw.sin(), y * yaw.cos() - x * yaw.sin()
    return swept_distance(u, v, torch.zeros_like(u), torch.zeros_like(u))


def swept_distance(u: Tensor, v: Tensor, back: Tensor, forth: Tensor) -> Tensor:
    """Return the distance of points from the area swept by a stick's axes [m].

    It is exact for axes along the stick or across it, as in the benchmark's stick; for
    others it is the distance from the bounding rectangle.

    Args:
        u: Coordinate of the points ahead of the gripper at the start of the motion [m].
        v: Coordinate of the points to its left [m].
        back: Motion of the stick backward, at most 0 [m].
        forth: Motion of the stick ahead, at least 0 [m].
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
