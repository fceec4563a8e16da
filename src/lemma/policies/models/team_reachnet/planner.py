"""The team's planner: from scenes, goals and rules to scores of moves.

Tokens are entities, robots, regions and the whole scene; relations of two of them bias
the attention. As in :mod:`lemma.policies.models.reachnet.planner`, colors are no input,
and a score contains the log-probability that the robot reaches both ends of the move.
It also contains the log-probabilities that the goal has the pair that the move makes,
and that the rule permits the move.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Depth, Share, Width
from lemma.policies.layers import drawn, mlp, planner_layers
from lemma.policies.models.team_reachnet.reader import Reading
from lemma.policies.models.team_reachnet.table import TeamTable
from lemma.policies.models.team_reachnet.teams import (
    REGIONS,
    ROBOTS,
    members,
    regions_there,
)

_ABSENT = -20.0
_DISTANCES_M = (0.0, 0.05, 0.12, 0.25, 0.5, 1.0)
_UNIT_M = 0.05
_ENTITY, _ROBOT, _REGION = 14, 8, 4
_OBJECTS, _REACH, _TEAM, _PLACE = len(_DISTANCES_M) + 6, 3, 3, 3
RELATIONS = _OBJECTS + _REACH + _TEAM + _PLACE


@dataclass(frozen=True)
class TeamPlannerConfig:
    """Options of the planner."""

    width: Width = 128
    """Width of a token."""
    layers: Depth = 5
    """Number of layers of the transformer."""
    heads: Depth = 4
    """Number of heads of the attention."""
    dropout: Share = 0.05
    """Probability of dropout in training."""


class TeamPlanner(nn.Module):
    """A network that scores all moves of all robots, and ``stop``."""

    def __init__(self, config: TeamPlannerConfig) -> None:
        """Make the weights."""
        super().__init__()
        width = config.width
        self.entity_in = mlp(_ENTITY, width, width)
        self.robot_in = mlp(_ROBOT, width, width)
        self.region_in = mlp(_REGION, width, width)
        self.whole = drawn(1, width)
        self.relation = mlp(RELATIONS, 48, config.heads)
        self.layers = planner_layers(width, config.heads, config.dropout, config.layers)
        self.norm = nn.LayerNorm(width)
        self.pick, self.place, self.robot = (nn.Linear(width, width) for _ in range(3))
        self.pair = nn.Linear(_OBJECTS, width)
        self.reach = nn.Linear(2 * (_REACH + _PLACE), width)
        self.out = nn.Sequential(nn.SiLU(), nn.Linear(width, 1))
        self.stop = mlp(width, width, 1)
        self.sharpness = nn.Parameter(torch.tensor(math.log(50.0)))
        self.weight = nn.Parameter(torch.tensor(0.0))

    def forward(self, table: TeamTable, read: Reading) -> Tensor:
        """Return the score of every move and of ``stop``, (B, R * C * P + 1).

        The order is that of :func:`number_of`; P counts the targets and the regions.

        Args:
            table: B scenes.
            read: Shares of readings.
        """
        relations = _relations(table, read)
        tokens = torch.cat(
            [
                self.entity_in(_entities(table, read)),
                self.robot_in(_robots(table, read)),
                self.region_in(_regions(table)),
                self.whole.expand(len(table), 1, -1),
            ],
            1,
        )
        bias = self.relation(relations).permute(0, 3, 1, 2)
        known = torch.cat([table.there, table.team, regions_there(table.team)], 1)
        unseen = F.pad(~known, (0, 1))
        bias = bias.masked_fill(unseen[:, None, None], _ABSENT)
        for layer in self.layers:
            tokens = layer(tokens, bias)
        moves, stop = self._scores(self.norm(tokens), table, relations)
        asked, unfinished = _asked(table, read)
        moves = moves + self._possible(table) + asked
        return torch.cat([moves.flatten(1), stop + unfinished], 1)

    def _scores(
        self, tokens: Tensor, table: TeamTable, relations: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the learned scores of moves, (B, R, C, P), and of ``stop``, (B, 1)."""
        entities, cargo = len(table.entities), table.entities.cargo
        targets, last = table.entities.stick, tokens.shape[1] - 1
        robots = slice(entities, entities + ROBOTS)
        regions = torch.arange(entities + ROBOTS, last, device=tokens.device)
        ends = torch.cat([torch.arange(targets, device=tokens.device), regions])
        pair = relations[:, :cargo, :, :_OBJECTS].index_select(2, ends)
        of_robots = relations[:, robots]
        reach = torch.cat(
            [of_robots[..., _OBJECTS : _OBJECTS + _REACH], of_robots[..., -_PLACE:]], -1
        )
        picks, places = reach[:, :, :cargo], reach.index_select(2, ends)
        both = torch.cat(
            [
                picks[:, :, :, None].expand(-1, -1, -1, len(ends), -1),
                places[:, :, None].expand(-1, -1, cargo, -1, -1),
            ],
            -1,
        )
        hidden = (
            self.pick(tokens[:, :cargo])[:, None, :, None]
            + (self.place(tokens.index_select(1, ends))[:, None] + self.pair(pair))[
                :, None
            ]
            + self.robot(tokens[:, robots])[:, :, None, None]
            + self.reach(both)
        )
        moves = self.out(hidden).squeeze(-1).float()
        return moves, self.stop(tokens[:, -1]).float()

    def _possible(self, table: TeamTable) -> Tensor:
        """Return what to add to the scores of moves, (B, R, C, P): reach, and never."""
        cargo, targets = table.entities.cargo, table.entities.stick
        logs = self.weight.exp() * F.logsigmoid(
            self.sharpness.exp() * table.margins(table.xy)
        ).clamp(min=-30.0)
        free = table.there & table.clear
        graspable = table.traits.graspable[:cargo]
        bears = table.traits.support_m[:targets] >= 0.0
        pick = logs[:, :, :cargo] + _ABSENT * ~(free[:, :cargo] & graspable)[:, None]
        place = logs[:, :, :targets] + _ABSENT * ~(free[:, :targets] & bears)[:, None]
        is_in = members(table.team) & regions_there(table.team)[..., None]
        region = _ABSENT * (~is_in).float().transpose(1, 2)
        place = torch.cat([place, region], 2)
        same = torch.eye(cargo, place.shape[2], device=place.device) * _ABSENT
        robot = _ABSENT * (~table.team).float()[:, :, None, None]
        # A weak hand does not lift a heavy thing.
        able = 1.0 - table.weak[..., None].float() * table.heavy[:, None, :cargo]
        pick = pick + _log(able)
        found: Tensor = pick[..., None] + place[:, :, None] + same + robot
        return found


def _asked(table: TeamTable, read: Reading) -> tuple[Tensor, Tensor]:
    """Return log-probabilities that goal and rule ask for moves and for ``stop``.

    Returns:
        For moves, (B, R, C, P): that the goal has the pair, or for regions any pair of
        the movable entity; that it does not hold yet; and that the rule permits it. For
        ``stop``, (B, 1): that all pairs hold.
    """
    targets = table.entities.stick
    goal, nothing = read.bottoms[..., :targets], read.bottoms[..., targets:]
    done = (goal * table.on()).sum(-1)
    later, first, kept = read.roles.unbind(1)
    open_first = (first * (1.0 - done)).sum(1, keepdim=True)
    entity = goal * (1.0 - (later * open_first)[..., None])
    onto = torch.cat([entity, (1.0 - nothing).expand(-1, -1, len(REGIONS))], 2)
    onto = onto * ((1.0 - done) * (1.0 - kept))[..., None]
    asked = onto[:, None] * (1.0 - read.excluded)[:, :, None, None]
    held = (1.0 - (1.0 - nothing.squeeze(2)) * (1.0 - done)).prod(1, keepdim=True)
    return _log(asked), _log(held)


def _log(share: Tensor) -> Tensor:
    found: Tensor = share.clamp(min=math.exp(_ABSENT)).log()
    return found


def number_of(move: Tensor, cargo: int, targets: int) -> Tensor:
    """Return the numbers of moves among all scores, (B,); that of ``stop`` for -1.

    Args:
        move: Color of the robot, movable entity, and entity or region, the latter as
            numbers behind all entities, (B, 3).
        cargo: C.
        targets: T; the stick behind them is no target.
    """
    robot, pick, place = move.unbind(1)
    ends = targets + len(REGIONS)
    end = torch.where(place > targets, place - 1, place)
    number = (robot * cargo + pick) * ends + end
    return torch.where(robot < 0, ROBOTS * cargo * ends, number)


def move_of(number: Tensor, cargo: int, targets: int) -> Tensor:
    """Return the moves of numbers, (B, 3): the inverse of :func:`number_of`."""
    ends = targets + len(REGIONS)
    rest, end = number // ends, number % ends
    place = torch.where(end >= targets, end + 1, end)
    move = torch.stack([rest // cargo, rest % cargo, place], 1)
    return torch.where((rest >= ROBOTS * cargo)[:, None], -1, move)


def _entities(table: TeamTable, read: Reading) -> Tensor:
    """Return the features of entities, (B, E, _ENTITY)."""
    cargo, targets, count = (
        table.entities.cargo,
        table.entities.stick,
        len(table.entities),
    )
    goal = read.bottoms[..., :targets]
    done = (goal * table.on()).sum(-1)
    tops = torch.stack([goal.sum(-1), done, *read.roles.unbind(1)], -1)
    bottoms = torch.stack([goal.sum(1), (goal * table.on()).sum(1)], -1)
    parts = [
        table.cargo.float().expand(len(table), -1)[..., None],
        table.there[..., None].float(),
        table.clear[..., None].float(),
        torch.where(table.there[..., None], table.xy, 0.0),
        (table.rise / _UNIT_M)[..., None],
        table.heavy[..., None],
        F.pad(tops, (0, 0, 0, count - cargo)),
        F.pad(bottoms, (0, 0, 0, count - targets)),
    ]
    return torch.cat(parts, -1)


def _robots(table: TeamTable, read: Reading) -> Tensor:
    """Return the features of robots, (B, R, _ROBOT)."""
    there = table.team[..., None]
    return torch.cat(
        [
            torch.where(there, table.bases, 0.0),
            torch.where(there, table.radii, 0.0),
            there.float(),
            table.weak[..., None].float(),
            read.excluded[..., None],
        ],
        -1,
    )


def _regions(table: TeamTable) -> Tensor:
    """Return the features of regions, (B, regions, _REGION)."""
    there = regions_there(table.team)
    spots = torch.where(there[..., None], table.spots(), 0.0)
    numbers = torch.arange(len(REGIONS), device=there.device)
    of_all = (numbers == 0).expand_as(there)
    return torch.cat([spots, there[..., None].float(), of_all[..., None].float()], -1)


def _relations(table: TeamTable, read: Reading) -> Tensor:
    """Return the relations of tokens, (B, L, L, RELATIONS), in four groups of columns.

    They are those of two entities, of a robot and an entity or region, of two robots,
    and of a region and an entity or robot.
    """
    count, robots, regions = len(table.entities), ROBOTS, len(REGIONS)
    length = count + robots + regions + 1
    found = table.xy.new_zeros(len(table), length, length, RELATIONS)
    objects, arms = slice(0, count), slice(count, count + robots)
    areas = slice(count + robots, length - 1)
    found[:, objects, objects, :_OBJECTS] = _of_objects(table, read)
    spots = table.spots()
    at = _OBJECTS
    for columns, points in ((objects, table.xy), (areas, spots)):
        facts = _of_reach(table, points)
        found[:, arms, columns, at : at + _REACH] = facts
        found[:, columns, arms, at : at + _REACH] = facts.transpose(1, 2)
    at += _REACH
    found[:, arms, arms, at : at + _TEAM] = _of_robots(table)
    at += _TEAM
    inside = members(table.team)
    found[:, areas, arms, at] = inside.float()
    found[:, arms, areas, at] = inside.float().transpose(1, 2)
    # A point lies in a region if all of its robots reach it.
    margins = table.margins(table.xy)
    least = torch.where(inside[..., None], margins[:, None], 9.0).amin(2)
    least = torch.where(table.there[:, None], least, -1.0)
    facts = torch.stack([(least / 0.02).tanh(), (least / 0.15).tanh()], -1)
    found[:, areas, objects, at + 1 : at + 3] = facts
    found[:, objects, areas, at + 1 : at + 3] = facts.transpose(1, 2)
    return found


def _of_objects(table: TeamTable, read: Reading) -> Tensor:
    cargo, targets, count = (
        table.entities.cargo,
        table.entities.stick,
        len(table.entities),
    )
    apart = (table.xy[:, :, None] - table.xy[:, None]).norm(dim=-1)
    near = [
        torch.exp(-(((apart - middle) / max(0.03, 0.5 * middle)) ** 2))
        for middle in _DISTANCES_M
    ]
    rise = (table.rise[:, :, None] - table.rise[:, None]) / _UNIT_M
    more = (0, count - targets, 0, count - cargo)
    goal = F.pad(read.bottoms[..., :targets], more)
    on = F.pad(table.on().float(), more)
    held = [goal, goal.transpose(1, 2), on, on.transpose(1, 2), goal * on]
    found = torch.stack([*near, rise.clamp(-3, 3), *held], -1)
    both = table.there[:, :, None] & table.there[:, None]
    return torch.where(both[..., None], found, 0.0)


def _of_reach(table: TeamTable, points: Tensor) -> Tensor:
    margins = table.margins(points)
    away = (points[:, None] - table.bases[:, :, None]).norm(dim=-1)
    facts = [(margins / 0.02).tanh(), (margins / 0.15).tanh(), away.clamp(max=2.0)]
    there = table.team[:, :, None, None]
    return torch.where(there, torch.stack(facts, -1), 0.0)


def _of_robots(table: TeamTable) -> Tensor:
    apart = (table.bases[:, :, None] - table.bases[:, None]).norm(dim=-1)
    outer = table.radii[..., 1]
    overlap = outer[:, :, None] + outer[:, None] - apart
    facts = [apart.clamp(max=4.0), (overlap / 0.3).tanh(), (overlap / 0.05).tanh()]
    both = table.team[:, :, None] & table.team[:, None]
    return torch.where(both[..., None], torch.stack(facts, -1), 0.0)
