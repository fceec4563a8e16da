"""ReachNet's tables: what is known of a scene, as a few small vectors.

Everything behind perception works on tables. They come from images, or in training
also from the labels, with noise: then the planner sees many variants of every frame for
the price of a few vectors.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Self

import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, Labels
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import ENTITIES, STICK, kind_of
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.stick import GRASP_FROM_END_M

CUBES = tuple(i for i, name in enumerate(ENTITIES) if kind_of(name) is CUBE)
"""Numbers of the cubes; they come first."""
PADS = tuple(i for i, name in enumerate(ENTITIES) if kind_of(name) is PAD)
THE_STICK = ENTITIES.index(STICK)
CONJUNCTS = 2
"""Largest number of (top, bottom) pairs of a goal."""
FAR_M = 10.0
"""Where things are that are not there."""

_COVERS_M = 0.035
_ABOVE_M = 0.02
_QUARTER_RAD = 0.5 * math.pi


@dataclass(frozen=True, eq=False)
class SceneTable:
    """What is known of B scenes with R robots; tensors on one device, float32."""

    present: Tensor
    """Which entities are seen, (B, 11) bool. What lies under a cube is not."""
    xy: Tensor
    """Positions [m], (B, 11, 2); ``FAR_M`` where nothing is seen."""
    yaw: Tensor
    """(B, 11) [rad]: cubes within a quarter turn, the stick's, and 0 for pads."""
    top: Tensor
    """Height of the upper face of each cube [m], (B, 11); 0 for the rest."""
    bases: Tensor
    """Positions of the robots' bases [m], (B, R, 2)."""
    rings: Tensor
    """Radii between which each robot reaches [m], (B, R, 2): inner, outer."""

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self.xy)

    @property
    def grasp(self) -> Tensor:
        """Where the stick is grasped [m], (B, 2)."""
        yaw = self.yaw[:, THE_STICK]
        along = torch.stack([yaw.cos(), yaw.sin()], -1)
        return self.xy[:, THE_STICK] + GRASP_FROM_END_M * along

    def margins(self, points: Tensor) -> Tensor:
        """Return how far inside each robot's reach points are [m], (B, R, ...).

        Args:
            points: (B, ..., 2) [m].
        """
        extra = (1,) * (points.dim() - 2)
        bases = self.bases.view(len(self), -1, *extra, 2)
        inner, outer = self.rings.view(len(self), -1, *extra, 2).unbind(-1)
        distance = (points.unsqueeze(1) - bases).norm(dim=-1)
        return torch.minimum(distance - inner, outer - distance)

    def rows(self, index: Tensor) -> Self:
        """Return some of the scenes."""
        return replace(self, **{f.name: getattr(self, f.name)[index] for f in _FIELDS})

    def detached(self) -> Self:
        """Return the same without gradients."""
        return replace(
            self, **{f.name: getattr(self, f.name).detach() for f in _FIELDS}
        )

    @classmethod
    def joined(cls, tables: "list[SceneTable]") -> "SceneTable":
        """Return all scenes of some tables."""
        return SceneTable(
            *(torch.cat([getattr(t, f.name) for t in tables]) for f in _FIELDS)
        )


_FIELDS = fields(SceneTable)


def yaw_of(quaternion: Tensor) -> Tensor:
    """Return the rotation about the vertical of quaternions wxyz, (...) [rad]."""
    w, x, y, z = quaternion.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quarter(yaw: Tensor) -> Tensor:
    """Return angles within an eighth of a turn from zero: those of a square."""
    return yaw - _QUARTER_RAD * torch.round(yaw / _QUARTER_RAD)


def true_table(labels: Labels, rings: Tensor) -> SceneTable:
    """Return what a perfect eye would see.

    Args:
        labels: Where everything is.
        rings: Radii of reach, (B, R, 2) [m].
    """
    position, there = labels.objects[..., :3], labels.objects[..., 0].isfinite()
    xyz = torch.where(there.unsqueeze(-1), position, FAR_M)
    present = there & ~_covered(xyz, there)
    turned = yaw_of(labels.objects[..., 3:])
    yaw = torch.zeros_like(turned)
    cubes, stick = slice(0, len(CUBES)), THE_STICK
    yaw[:, cubes] = quarter(turned[:, cubes])
    yaw[:, stick] = turned[:, stick]
    top = torch.zeros_like(yaw)
    top[:, cubes] = xyz[:, cubes, 2] + CUBE.origin_m
    return SceneTable(
        present=present,
        xy=torch.where(present.unsqueeze(-1), xyz[..., :2], FAR_M),
        yaw=torch.where(present, yaw, 0.0),
        top=torch.where(present, top, 0.0),
        bases=labels.bases[..., :2],
        rings=rings,
    )


def _covered(xyz: Tensor, there: Tensor) -> Tensor:
    """Return which cubes lie under another one, (B, 11)."""
    cubes = xyz[:, : len(CUBES)]
    apart = (xyz[:, :, None, :2] - cubes[:, None, :, :2]).norm(dim=-1)
    above = cubes[:, None, :, 2] - xyz[:, :, None, 2]
    is_cube = torch.arange(xyz.shape[1], device=xyz.device) < len(CUBES)
    over = (apart < _COVERS_M) & (above > _ABOVE_M) & is_cube[None, :, None]
    covered: Tensor = (over & there[:, None, : len(CUBES)]).any(-1)
    return covered


@dataclass(frozen=True)
class Noise:
    """How far tables in training differ from the truth, as eyes err."""

    position_m: float = 0.003
    """Standard deviation of positions."""
    yaw_rad: float = 0.02
    """Standard deviation of yaws."""
    height_m: float = 0.003
    """Standard deviation of heights."""
    base_m: float = 0.004
    """Standard deviation of bases and of radii of reach."""
    unseen: float = 0.01
    """Share of entities that the sub-task does not need and that are missed."""


def disturbed(table: SceneTable, noise: Noise, needed: Tensor) -> SceneTable:
    """Return a table as an eye that errs would see it.

    Args:
        table: The truth.
        noise: How much it errs.
        needed: Entities that are never missed, (B, 11) bool.
    """

    def jitter(values: Tensor, deviation: float) -> Tensor:
        return values + deviation * torch.randn_like(values)

    missed = (torch.rand_like(table.yaw) < noise.unseen) & ~needed
    present = table.present & ~missed
    xy = jitter(table.xy, noise.position_m)
    return SceneTable(
        present=present,
        xy=torch.where(present.unsqueeze(-1), xy, FAR_M),
        yaw=torch.where(present, jitter(table.yaw, noise.yaw_rad), 0.0),
        top=torch.where(present, jitter(table.top, noise.height_m), 0.0),
        bases=jitter(table.bases, noise.base_m),
        rings=jitter(table.rings, noise.base_m),
    )


def turned(table: SceneTable) -> SceneTable:
    """Return the table turned by half a turn, with the robots in reverse order.

    Sub-tasks turn with :func:`turned_numbers`.
    """
    yaw = table.yaw.clone()
    yaw[:, THE_STICK] += math.pi
    return replace(
        table,
        xy=torch.where(table.present.unsqueeze(-1), -table.xy, FAR_M),
        yaw=yaw,
        bases=-table.bases.flip(1),
        rings=table.rings.flip(1),
    )


def turned_numbers(decisions: Tensor, robots: int) -> Tensor:
    """Return sub-tasks (..., 4) with the robots in reverse order."""
    robot = decisions[..., :1]
    flipped = torch.where(robot == NOBODY, robot, robots - 1 - robot)
    return torch.cat([flipped, decisions[..., 1:]], -1)


def needed_entities(decision: Tensor, goal: Tensor) -> Tensor:
    """Return the entities that sub-tasks and goals name, (B, 11) bool.

    Args:
        decision: (B, 4) int64.
        goal: (B, conjuncts, 2) int64; -1 for none.
    """
    named = torch.cat([decision[:, 2:], goal.flatten(1)], 1)
    count = len(ENTITIES)
    named = torch.where((named < 0) | (named >= count), count, named)
    hot = torch.zeros(len(decision), count + 1, device=decision.device)
    hot.scatter_(1, named, 1.0)
    hot[:, THE_STICK] = 1.0
    return hot[:, :count] > 0
