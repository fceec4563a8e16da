"""The state of a scene for a team, and how moves change it."""

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.batch import Labels
from lemma.policies.entities import EntitySet, Traits, traits_of
from lemma.policies.layers import constant
from lemma.policies.models.reachnet.noise import Noise
from lemma.policies.models.reachnet.scene_table import FAR_M, SceneTable, covered
from lemma.policies.models.team_reachnet.teams import PAIRS

_ON_M = 0.035
"""Distance below which an object above another one lies on it [m]."""
_LEVEL_M = 0.012
"""Largest error of the height of its support [m]."""


@dataclass(frozen=True, eq=False)
class TeamTable:
    """B scenes with E entities and robots of R colors, world frame."""

    there: Tensor
    """Whether entities are on the table, (B, E) bool."""
    xy: Tensor
    """Positions [m], (B, E, 2); ``FAR_M`` for absent ones."""
    rise: Tensor
    """Height of the support of movable entities [m], (B, E); 0 for the rest."""
    clear: Tensor
    """Whether nothing lies on entities, (B, E) bool."""
    team: Tensor
    """Whether there is a robot of each color, (B, R) bool."""
    weak: Tensor
    """Whether it has another hand than the standard one, (B, R) bool."""
    heavy: Tensor
    """1 for entities that are too heavy for such a hand, (B, E)."""
    bases: Tensor
    """Positions of the bases [m], (B, R, 2); ``FAR_M`` for absent robots."""
    radii: Tensor
    """Radii of reach [m], (B, R, 3), as in
    :class:`~lemma.policies.models.reachnet.scene_table.SceneTable`."""
    entities: EntitySet

    @property
    def traits(self) -> Traits:
        """Properties of the entities' kinds."""
        return traits_of(self.entities, self.xy.device)

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self.xy)

    def margins(self, points: Tensor) -> Tensor:
        """Return the margins of points (B, N, 2) inside reaches, (B, R, N) [m]."""
        apart = (points[:, None] - self.bases[:, :, None]).norm(dim=-1)
        inner, outer, _ = self.radii[:, :, None].unbind(-1)
        found: Tensor = torch.minimum(apart - inner, outer - apart)
        return found

    def on(self) -> Tensor:
        """Return whether each movable entity lies on each entity, (B, C, T) bool."""
        cargo, targets = self.entities.cargo, self.entities.stick
        apart = (self.xy[:, :cargo, None] - self.xy[:, None, :targets]).norm(dim=-1)
        level = (self.rise + self.traits.height_m)[:, None, :targets]
        off = (self.rise[:, :cargo, None] - level).abs()
        itself = torch.eye(cargo, targets, dtype=torch.bool, device=apart.device)
        both = self.there[:, :cargo, None] & self.there[:, None, :targets]
        found: Tensor = both & (apart < _ON_M) & (off < _LEVEL_M) & ~itself
        return found

    def spots(self) -> Tensor:
        """Return a position in each region, (B, regions, 2) [m].

        It divides the way between two bases in proportion to their reach. The region of
        all robots has the mean of the bases, or the spot of the pair.
        """
        one, other = constant(PAIRS, self.xy.device).unbind(1)
        outer = self.radii[..., 1].clamp(min=0.1)
        share = outer[:, one] / (outer[:, one] + outer[:, other])
        way = self.bases[:, other] - self.bases[:, one]
        pairs = self.bases[:, one] + share[..., None] * way
        team = self.team.float()
        weights = team * torch.where(
            self.team.sum(1, keepdim=True) == 2, 1.0 / outer, 1.0
        )
        weights = weights / weights.sum(1, keepdim=True)
        near = torch.where(self.team[..., None], self.bases, 0.0)
        middle = (weights[..., None] * near).sum(1)
        return torch.cat([middle[:, None], pairs], 1)

    def joined(self, other: Self) -> Self:
        """Return the scenes of both."""
        both: dict[str, Any] = {
            n: torch.cat([getattr(self, n), getattr(other, n)]) for n in _TENSORS
        }
        return replace(self, **both)

    def moved(self, pick: Tensor, place: Tensor) -> Self:
        """Return the scenes after moves.

        Args:
            pick: Number of the moved entity, (B,); -1 for no move.
            place: Number of the entity or region on which it is put, (B,).
        """
        count, cargo = len(self.entities), self.entities.cargo
        moves = pick >= 0
        rows = torch.arange(len(self), device=pick.device)
        item, onto = pick.clamp(min=0), place.clamp(min=0)
        region = onto >= count
        under = onto.clamp(max=count - 1)
        spot = self.spots()[rows, (onto - count).clamp(min=0)]
        at = torch.where(region[:, None], spot, self.xy[rows, under])
        level = (self.rise + self.traits.height_m)[rows, under]
        level = torch.where(region, 0.0, level)
        # The former support is clear again.
        left = F.pad(self.on(), (0, count - self.entities.stick))
        left = left[rows, item.clamp(max=cargo - 1)]
        hot = F.one_hot(item, count).bool() & moves[:, None]
        covered = F.one_hot(under, count).bool() & (moves & ~region)[:, None]
        return replace(
            self,
            xy=torch.where(hot[..., None], at[:, None], self.xy),
            rise=torch.where(hot, level[:, None], self.rise),
            clear=(self.clear | (left & moves[:, None])) & ~covered,
        )

    def turned(self, angle: Tensor) -> Self:
        """Return the scenes turned by angles (B,) about the middle of the table."""
        cos, sin = angle.cos(), angle.sin()
        turn = torch.stack([cos, -sin, sin, cos], -1).view(-1, 2, 2)

        def there(xy: Tensor, known: Tensor) -> Tensor:
            return torch.where(known[..., None], xy @ turn.transpose(1, 2), FAR_M)

        return replace(
            self,
            xy=there(self.xy, self.there),
            bases=there(self.bases, self.team),
        )

    def disturbed(self, noise: Noise) -> Self:
        """Return the scenes with simulated errors of perception."""

        def jitter(values: Tensor, deviation: float) -> Tensor:
            return values + deviation * torch.randn_like(values)

        xy = jitter(self.xy, noise.position_m)
        bases = jitter(self.bases, noise.base_m)
        return replace(
            self,
            xy=torch.where(self.there[..., None], xy, FAR_M),
            rise=self.rise + noise.height_m * torch.randn_like(self.rise) * self.cargo,
            bases=torch.where(self.team[..., None], bases, FAR_M),
            radii=jitter(self.radii, noise.base_m),
        )

    @property
    def cargo(self) -> Tensor:
        """Whether each entity is movable, (E,) bool."""
        numbers = torch.arange(len(self.entities), device=self.xy.device)
        return numbers < self.entities.cargo


_TENSORS = tuple(f.name for f in fields(TeamTable) if f.type is Tensor)


def team_table(scene: SceneTable, team: Tensor, weak: Tensor) -> TeamTable:
    """Return perceived scenes; entities that are not seen are not on the table.

    None is heavy.

    Args:
        scene: Scenes with robots by color.
        team: Whether there is a robot of each color, (B, R) bool.
        weak: Whether it has another hand than the standard one, (B, R) bool.
    """
    numbers = torch.arange(len(scene.entities), device=team.device)
    bottom = scene.top - scene.traits.height_m
    rise = torch.where(scene.present & (numbers < scene.cargo), bottom, 0.0)
    return TeamTable(
        there=scene.present,
        xy=scene.xy,
        rise=rise.clamp(min=0.0),
        clear=scene.present,
        team=team,
        weak=weak,
        heavy=torch.zeros_like(scene.top),
        bases=torch.where(team[..., None], scene.bases, FAR_M),
        radii=scene.radii,
        entities=scene.entities,
    )


def true_table(
    labels: Labels, radii: Tensor, team: Tensor, weak: Tensor, entities: EntitySet
) -> TeamTable:
    """Return true scenes.

    Args:
        labels: True poses, with rows of robots by color.
        radii: Radii of reach [m], (B, R, 3).
        team: Whether there is a robot of each color, (B, R) bool.
        weak: Whether it has another hand than the standard one, (B, R) bool.
        entities: Entities, in the order of their numbers.
    """
    objects = labels.objects
    traits, there = traits_of(entities, team.device), objects[..., 0].isfinite()
    xyz = torch.where(there[..., None], objects[..., :3], FAR_M)
    top_m = xyz[..., 2] + traits.top_m
    cargo = torch.arange(len(entities), device=team.device) < entities.cargo
    return TeamTable(
        there=there,
        xy=xyz[..., :2],
        rise=torch.where(there & cargo, top_m - traits.height_m, 0.0),
        clear=there & ~covered(xyz, top_m, traits, entities.cargo),
        team=team,
        weak=weak,
        heavy=labels.heavy.float(),
        bases=torch.where(team[..., None], labels.bases[..., :2], FAR_M),
        radii=radii,
        entities=entities,
    )


def remembered(now: TeamTable, first: TeamTable) -> TeamTable:
    """Return scenes with the fixed entities that are hidden now, as seen at first."""
    hidden = first.there & ~now.there & ~now.cargo
    return replace(
        now,
        there=now.there | hidden,
        xy=torch.where(hidden[..., None], first.xy, now.xy),
        clear=now.clear & ~hidden,
    )


def recalled(now: TeamTable, memory: TeamTable) -> TeamTable:
    """Return scenes with all entities that are hidden now, as they are remembered.

    Args:
        now: The scenes as they are seen.
        memory: The first scenes, after all moves that succeeded.
    """
    hidden = memory.there & ~now.there
    return replace(
        now,
        there=now.there | hidden,
        xy=torch.where(hidden[..., None], memory.xy, now.xy),
        rise=torch.where(hidden, memory.rise, now.rise),
        heavy=torch.where(hidden, memory.heavy, now.heavy),
        clear=now.clear & ~hidden,
    )
