"""The state of a scene for a team, and how sub-tasks change it.

Rows of robots are numbered by color, because a robot's color is what pictures and
sentences tell of it. So a network has no weights for a robot's place in its team.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from typing import Any, Self

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.core.errors import InvalidConfigError
from lemma.policies.batch import NOBODY, PRIMITIVES
from lemma.policies.entities import EntitySet, Traits, traits_of
from lemma.policies.layers import constant
from lemma.policies.models.reachnet.scene_table import (
    FAR_M,
    Noise,
    SceneTable,
    covered,
)
from lemma.robots.hand import STANDARD
from lemma.scene.objects.entity import SHARED, pair_regions
from lemma.scene.spec import ROBOT_COLORS

ROBOTS = len(ROBOT_COLORS)
"""Number of colors of robots, and the largest size of a team."""
PAIRS = tuple(combinations(range(ROBOTS), 2))
"""Pairs of colors, in the order of the regions of pairs."""
REGIONS = (SHARED, *pair_regions(ROBOTS))
"""The region of all robots, and those of pairs."""
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
        bases=torch.where(team[..., None], scene.bases, FAR_M),
        radii=scene.radii,
        entities=scene.entities,
    )


def true_table(
    objects: Tensor,
    bases: Tensor,
    radii: Tensor,
    team: Tensor,
    weak: Tensor,
    entities: EntitySet,
) -> TeamTable:
    """Return true scenes.

    Args:
        objects: Position [m] and quaternion of each entity, (B, E, 7); NaN if none.
        bases: x, y [m], yaw of each color's robot, (B, R, 3).
        radii: Radii of reach [m], (B, R, 3).
        team: Whether there is a robot of each color, (B, R) bool.
        weak: Whether it has another hand than the standard one, (B, R) bool.
        entities: Entities, in the order of their numbers.
    """
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
        bases=torch.where(team[..., None], bases[..., :2], FAR_M),
        radii=radii,
        entities=entities,
    )


def distinct(colors: Sequence[str]) -> tuple[str, ...]:
    """Return a color for each robot of a team, which no other robot has.

    Both robots of a pair may be of one color: then the left one, which comes first,
    keeps it, and the right one counts as one of the first other color.
    """
    found: list[str] = []
    for color in colors:
        others = (other for other in ROBOT_COLORS if other not in (*found, *colors))
        found.append(color if color not in found else next(others))
    return tuple(found)


def numbers_by_color(teams: Sequence[Sequence[str]], device: torch.device) -> Tensor:
    """Return the number of each color's robot in its team, (B, R); -1 for none.

    Args:
        teams: Colors of the robots of each scene.
        device: Device of the result.
    """
    rows = [
        [team.index(color) if color in team else -1 for color in ROBOT_COLORS]
        for team in teams
    ]
    return torch.tensor(rows, device=device)


def by_color(rows: Tensor, numbers: Tensor, fill: float = 0.0) -> Tensor:
    """Return rows of robots (B, N, ...) by color, (B, R, ...).

    Args:
        rows: In the order of the team.
        numbers: From :func:`numbers_by_color`.
        fill: Value for colors without a robot.
    """
    shape = (*numbers.shape, *rows.shape[2:])
    at = numbers.view(*numbers.shape, *(1,) * (rows.dim() - 2)).expand(shape)
    found: Tensor = torch.where(at >= 0, rows.gather(1, at.clamp(min=0)), fill)
    return found


def color_number(robot: int, team: Sequence[str]) -> int:
    """Return the number of a robot by color; -1 for none."""
    return ROBOT_COLORS.index(team[robot]) if robot >= 0 else -1


def region_number(name: str, team: Sequence[str]) -> int:
    """Return the number of a region by the colors of its robots."""
    if name == SHARED:
        return 0
    pair = sorted(color_number(int(d), team) for d in name.removeprefix(f"{SHARED}_"))
    return 1 + PAIRS.index((pair[0], pair[1]))


def region_name(number: int, team: Sequence[str]) -> str:
    """Return the name of a region in a team: the inverse of :func:`region_number`."""
    if number == 0:
        return SHARED
    robots = sorted(team.index(ROBOT_COLORS[color]) for color in PAIRS[number - 1])
    return f"{SHARED}_{robots[0]}{robots[1]}"


def regions_there(team: Tensor) -> Tensor:
    """Return whether regions have all their robots, (B, regions) bool.

    A team of two has no regions of pairs.
    """
    needed = constant(_MEMBERS, team.device)
    found = (team[:, None] | ~needed).all(2)
    found[:, 1:] &= team.sum(1, keepdim=True) > 2
    return found


_MEMBERS = (
    (False,) * ROBOTS,
    *(tuple(color in pair for color in range(ROBOTS)) for pair in PAIRS),
)
"""Robots that a region needs, by color; the region of all needs no certain one."""


def members(team: Tensor) -> Tensor:
    """Return whether robots belong to regions, (B, regions, R) bool."""
    pairs = constant(_MEMBERS[1:], team.device).expand(len(team), -1, -1)
    return torch.cat([team[:, None], pairs & team[:, None]], 1)


def remembered(now: TeamTable, first: TeamTable) -> TeamTable:
    """Return scenes with the fixed entities that are hidden now, as seen at first."""
    hidden = first.there & ~now.there & ~now.cargo
    return replace(
        now,
        there=now.there | hidden,
        xy=torch.where(hidden[..., None], first.xy, now.xy),
        clear=now.clear & ~hidden,
    )


def weak_hands(
    hands: Sequence[Sequence[str]], teams: Sequence[Sequence[str]], device: torch.device
) -> Tensor:
    """Return whether robots have another hand than the standard one, (B, R) bool."""
    rows = []
    for names, team in zip(hands, teams, strict=True):
        held = dict(zip(team, names, strict=False))
        rows.append([held.get(color, STANDARD) != STANDARD for color in ROBOT_COLORS])
    return torch.tensor(rows, device=device)


def move_numbers(
    decision: Sequence[int], team: Sequence[str], entities: EntitySet
) -> tuple[int, int, int]:
    """Return color, pick and place of a labelled decision; -1 for ``stop``."""
    robot, primitive, pick, place = decision
    if primitive == PRIMITIVES.index("stop"):
        return NOBODY, NOBODY, NOBODY
    if primitive != PRIMITIVES.index("move"):
        raise InvalidConfigError(
            f"The team's ReachNet knows moves alone, and no {PRIMITIVES[primitive]!r}. "
            "Leave out the tasks that need it."
        )
    if place >= len(entities):
        name = entities.places[place]
        place = len(entities) + region_number(name, team)
    return color_number(robot, team), pick, place
