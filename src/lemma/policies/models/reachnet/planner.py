"""ReachNet's planner: from a scene table, a goal and the past to the next sub-task.

It scores all possible sub-tasks of all robots. Colors are no input: entities differ by
their kind, their position and their role in the goal, so training on one color
generalises to all. A score is a learned function of the context plus, as in the paper's
utility, the log-probability that the robot reaches all that it needs.
"""

import math
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Depth, Share, Width
from lemma.policies.batch import NOBODY, PRIMITIVES, STOP, decision_numbers
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.layers import constant, drawn, mlp, planner_layers
from lemma.policies.models.reachnet.drags import SIGNS
from lemma.policies.models.reachnet.scene_table import CONJUNCTS, SceneTable
from lemma.policies.models.reachnet.utility import DragUtility
from lemma.tasks.subtask import SubTask

_TOOL_ROWS = ("prehook", "hook", "prepoke", "poke")
_ABSENT = -20.0
_RECENT = 2
_DISTANCES_M = (0.0, 0.03, 0.07, 0.12, 0.25, 0.5, 1.0)
_SUPPORTS_M = 0.035
_UNIT_M = 0.05
"""Unit of heights and radii of entities [m]."""
_KIND = 8

ROBOT_FEATURES = 9
_SIDE_OF = (0, 0, 1, 1)
PAIR = len(_DISTANCES_M) + 2
RELATIONS = PAIR + 4


@dataclass(frozen=True)
class PlannerConfig:
    """Options of the planner."""

    width: Width = 128
    """Width of a token."""
    layers: Depth = 4
    """Number of layers of the transformer."""
    heads: Depth = 4
    """Number of heads of the attention."""
    dropout: Share = 0.05
    """Probability of dropout in training."""
    past_dropout: Share = 0.5
    """Share of training frames without the past, so that the planner relies on the
    scene and recognises failures."""


class ReachNetPlanner(nn.Module):
    """A network that scores sub-tasks."""

    def __init__(self, config: PlannerConfig, robots: int, use_reach: bool) -> None:
        """Make the weights.

        Args:
            config: Options.
            robots: Number of robots of a team.
            use_reach: Whether to use the estimated reach.
        """
        super().__init__()
        self.config, self.robots, self.use_reach = config, robots, use_reach
        width = config.width
        self.entity_in = mlp(entity_feature_count(robots), width, width)
        self.robot_in = mlp(ROBOT_FEATURES, width, width)
        self.whole = drawn(2, width)
        self.numbers = drawn(robots, width)
        self.past_in = nn.Linear(len(PRIMITIVES) + robots, width)
        self.relation = mlp(RELATIONS, 32, config.heads)
        self.layers = planner_layers(width, config.heads, config.dropout, config.layers)
        self.norm = nn.LayerNorm(width)
        self.move_pick, self.move_place, self.move_robot = (
            nn.Linear(width, width) for _ in range(3)
        )
        self.pair = nn.Linear(PAIR, width)
        self.move_out = nn.Sequential(nn.SiLU(), nn.Linear(width, 1))
        self.tool_cube, self.tool_robot = (nn.Linear(width, width) for _ in range(2))
        self.tool_drag = nn.Linear(3 + 4, width)
        self.tool_kind = drawn(len(_TOOL_ROWS), width)
        self.tool_out = nn.Sequential(nn.SiLU(), nn.Linear(width, 1))
        self.hand_over = mlp(2 * width, width, 1)
        self.stop = mlp(width, width, 1)
        self.reach_sharpness = nn.Parameter(torch.tensor(math.log(50.0)))
        self.reach_weight = nn.Parameter(torch.tensor(0.0))

    def forward(
        self, table: SceneTable, goal: Tensor, past: Tensor, drags: DragUtility
    ) -> Tensor:
        """Return the score of every sub-task, (B, N); see :func:`number_of`.

        Args:
            table: B scenes.
            goal: (B, conjuncts, 2); -1 for none.
            past: Sub-tasks done before, oldest first, (B, P, 4); -1 for none.
            drags: Computes the utility of drags.
        """
        with torch.no_grad():
            values = drags.values(drags.drags(table))
        near = nearness(table)
        past = self._forgotten(past)
        known, count = table.detached(), len(table.entities)
        features = torch.cat(
            [
                kinds(known),
                reach_features(known, self.use_reach),
                roles(goal, count),
                goal_state(known, goal),
                stick_state(known, drags.ready(table.traits.drag_m).detach()),
                drag_features(values, count),
                recent(past, count),
            ],
            -1,
        )
        done = last(past, self.robots)
        tokens = torch.cat(
            [
                self.entity_in(features),
                self.robot_in(robot_features(known, self.use_reach)) + self.numbers,
                self.whole + self.past_in(done)[:, None],
            ],
            1,
        )
        bias = self._bias(near, table.present, tokens.shape[1])
        for layer in self.layers:
            tokens = layer(tokens, bias)
        return self._scores(self.norm(tokens), table, near, values)

    def _forgotten(self, past: Tensor) -> Tensor:
        if not self.training:
            return past
        forget = torch.rand(len(past), 1, 1, device=past.device)
        return torch.where(forget < self.config.past_dropout, NOBODY, past)

    def _bias(self, near: Tensor, present: Tensor, length: int) -> Tensor:
        """Return the attention bias, (B, heads, L, L)."""
        pairs = self.relation(near).permute(0, 3, 1, 2)
        more = length - pairs.shape[-1]
        bias = F.pad(pairs, (0, more, 0, more))
        unseen = F.pad(~present, (0, more))
        return bias.masked_fill(unseen[:, None, None], _ABSENT)

    def _scores(
        self, tokens: Tensor, table: SceneTable, near: Tensor, values: Tensor
    ) -> Tensor:
        count = len(tokens)
        cargo, stick, entities = table.cargo, table.stick, len(table.entities)
        cubes, robots = tokens[:, :cargo], tokens[:, entities : entities + self.robots]
        shared, whole = tokens[:, -2:-1], tokens[:, -1]
        onto = torch.cat([tokens[:, :stick], shared], 1)
        pair = F.pad(near[:, :cargo, :stick, :PAIR], (0, 0, 0, 1))
        hidden = (
            self.move_pick(cubes)[:, :, None, None]
            + (self.move_place(onto)[:, None] + self.pair(pair))[:, :, :, None]
            + self.move_robot(robots)[:, None, None]
        )
        moves = self.move_out(hidden).squeeze(-1)
        tool = (
            (self.tool_cube(cubes)[:, None] + self.tool_kind[:, None])[:, :, :, None]
            + self.tool_robot(robots)[:, None, None]
            + self.tool_drag(tool_features(values, table, self.use_reach))
        )
        tools = self.tool_out(tool).squeeze(-1)
        hands = self.hand_over(
            torch.cat([robots, whole[:, None].expand_as(robots)], -1)
        ).squeeze(-1)
        moves, tools, hands = self._reachable(table, moves, tools, hands)
        return torch.cat(
            [moves.flatten(1), tools.flatten(1), hands, self.stop(whole)], 1
        ).view(count, -1)

    def _reachable(
        self, table: SceneTable, moves: Tensor, tools: Tensor, hands: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Exclude sub-tasks that are always impossible.

        Absent entities and those that no gripper can hold are not moved, and nothing is
        placed on an entity that supports nothing.
        """
        cargo, stick, traits = table.cargo, table.stick, table.traits
        there = torch.where(table.present, 0.0, _ABSENT)
        lay = there[:, stick, None]
        pick = there[:, :cargo] + _ABSENT * (~traits.graspable[:cargo])
        bears = there[:, :stick] + _ABSENT * (traits.support_m[:stick] < 0.0)
        moves = moves + pick[:, :, None, None] + F.pad(bears, (0, 1))[:, None, :, None]
        same = torch.eye(cargo, stick + 1, device=moves.device) * _ABSENT
        moves = moves + same[:, :, None]
        follows = there[:, :cargo] + _ABSENT * (~traits.draggable[:cargo])
        tools = tools + follows[:, None, :, None] + lay[:, None, None]
        hands = hands + lay
        if not self.use_reach:
            return moves, tools, hands
        points = places(table)
        logs = self.reach_weight.exp() * F.logsigmoid(
            self.reach_sharpness.exp() * table.margins(points)
        ).clamp(min=-30.0).transpose(1, 2)
        grip = logs[:, stick]
        moves = moves + logs[:, :cargo, None]
        moves = moves + F.pad(logs[:, None, :stick], (0, 0, 0, 1))
        return moves, tools + grip[:, None, None], hands + grip


@cache
def _all_subtasks(
    robots: int, entities: EntitySet, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Return all sub-tasks, (N, 4), and their indices by the four numbers.

    They are: moving cargo onto entities and to the shared region; moving the stick to
    the shared region; using the stick on cargo; and ``stop``, whose index invalid
    combinations have, too.
    """
    cargo, stick, shared = range(entities.cargo), entities.stick, entities.shared
    ends = [(0, pick, place) for pick in cargo for place in (*range(stick), shared)]
    ends += [(PRIMITIVES.index(name), stick, on) for name in _TOOL_ROWS for on in cargo]
    ends.append((0, stick, shared))
    found = [(robot, *end) for end in ends for robot in range(robots)]
    shape = (robots, len(PRIMITIVES), len(entities), len(entities.places))
    # Cached, so they must not be inference tensors.
    with torch.inference_mode(False):
        numbers = torch.full(shape, len(found))
        for number, row in enumerate(found):
            numbers[row] = number
        rows = torch.tensor([*found, (NOBODY, STOP, NOBODY, NOBODY)])
        return rows.to(device), numbers.to(device)


def number_of(decision: Tensor, robots: int, entities: EntitySet = BENCHMARK) -> Tensor:
    """Return the indices of sub-tasks among all, (B,).

    Args:
        decision: Robot, primitive, pick, place, (B, 4).
        robots: Number of robots of a team.
        entities: Entities, in the order of their numbers.
    """
    numbers = _all_subtasks(robots, entities, decision.device)[1]
    # As an index -1 is the last robot and entity, which never have ``stop``.
    return numbers[decision.unbind(-1)]


def decision_of(number: Tensor, robots: int, entities: EntitySet = BENCHMARK) -> Tensor:
    """Return the sub-tasks of indices, (B, 4): the inverse of :func:`number_of`."""
    return _all_subtasks(robots, entities, number.device)[0][number]


def numbers_of(
    subtask: SubTask, robots: int, entities: EntitySet = BENCHMARK
) -> list[int]:
    """Return a sub-task as four numbers; those of ``stop`` if it is invalid."""
    nothing = [NOBODY, STOP, NOBODY, NOBODY]
    try:
        numbers = decision_numbers(subtask.to_dict(), entities)
    except ValueError:
        return nothing
    known = _all_subtasks(robots, entities, torch.device("cpu"))[0].tolist()
    return numbers if numbers in known and numbers[2] != numbers[3] else nothing


def entity_feature_count(robots: int) -> int:
    """Return the number of features of an entity."""
    goal_state = 2 * CONJUNCTS * 5
    drags = robots * len(SIGNS) * 3
    state = 7 + 3 * robots + 2 * CONJUNCTS + goal_state + 8 + drags + 7 * _RECENT
    return _KIND + state


def reach_features(table: SceneTable, use_reach: bool) -> Tensor:
    """Return features of each entity's margin in each robot's reach, (B, E, 3 R)."""
    points = places(table)
    margins = (
        table.margins(points) if use_reach else torch.zeros_like(table.margins(points))
    )
    rays = points[:, None] - table.bases[:, :, None]
    distances = rays.norm(dim=-1)
    found = [
        (margins / 0.02).tanh(),
        (margins / 0.15).tanh(),
        distances.clamp(max=2),
    ]
    there = table.present[:, None]
    found = [torch.where(there, f, 0.0) for f in found]
    return torch.cat([f.transpose(1, 2) for f in found], -1)


def robot_features(table: SceneTable, use_reach: bool) -> Tensor:
    """Return the features of each robot, (B, R, ROBOT_FEATURES)."""
    radii = table.radii if use_reach else torch.zeros_like(table.radii)
    centre = torch.zeros(len(table), 1, 2, device=radii.device)
    shared = table.margins(centre).squeeze(-1)
    gap = (table.bases - table.bases.flip(1)).norm(dim=-1, keepdim=True)
    overlap = radii[..., 1:2] + radii.flip(1)[..., 1:2] - gap
    if not use_reach:
        shared, overlap = torch.zeros_like(shared), torch.zeros_like(overlap)
    return torch.cat(
        [
            table.bases,
            radii,
            gap,
            (overlap / 0.3).tanh(),
            (overlap / 0.05).tanh(),
            (shared[..., None] / 0.1).tanh(),
        ],
        -1,
    )


def places(table: SceneTable) -> Tensor:
    """Return the grasp position of each entity, (B, E, 2) [m]."""
    return torch.cat([table.xy[:, : table.stick], table.grasp[:, None]], 1)


def kinds(table: SceneTable) -> Tensor:
    """Return properties of each entity's kind, and its pose, (B, E, 15)."""
    traits, count = table.traits, len(table.entities)
    numbers = torch.arange(count, device=table.xy.device)
    is_cargo, is_stick = numbers < table.cargo, numbers == table.stick
    sizes = torch.stack([traits.height_m, traits.disc_m, traits.support_m], -1)
    flags = [is_cargo, is_stick, traits.graspable, traits.draggable, traits.faceted]
    kind = torch.cat([torch.stack(flags, -1).float(), sizes / _UNIT_M], -1)
    there = table.present[..., None].float()
    level = (raised(table) / _UNIT_M)[..., None]
    heading = torch.stack([table.yaw.cos(), table.yaw.sin()], -1)
    heading = heading * is_stick[:, None]
    xy = torch.where(table.present[..., None], table.xy, 0.0)
    away = xy.norm(dim=-1, keepdim=True)
    kind = kind.expand(len(table), -1, -1)
    return torch.cat([kind, there, xy, level, heading, away], -1)


def raised(table: SceneTable) -> Tensor:
    """Return the height of each movable entity's support, (B, E) [m]; 0 for the rest.

    It is the height of the entity's top minus the entity's own height.
    """
    numbers = torch.arange(len(table.entities), device=table.xy.device)
    bottom = table.top - table.traits.height_m
    return torch.where(table.present & (numbers < table.cargo), bottom, 0.0)


def roles(goal: Tensor, count: int) -> Tensor:
    """Return each entity's roles in the goal, (B, E, 2 * conjuncts).

    Args:
        goal: (B, conjuncts, 2); -1 for none.
        count: E.
    """
    hot = F.one_hot(torch.where(goal == NOBODY, count, goal), count + 1)[..., :count]
    return hot.flatten(1, 2).transpose(1, 2).float()


def goal_state(table: SceneTable, goal: Tensor) -> Tensor:
    """Return the relation to each role's partner, (B, E, 2 * conjuncts * 5)."""
    index = goal.clamp(min=0)
    named = goal != NOBODY
    rows = torch.arange(len(table), device=goal.device)[:, None, None]
    xy, rise = table.xy[rows, index], raised(table)[rows, index] / _UNIT_M
    seen = table.present[rows, index] & named
    offset = xy[:, :, 0] - xy[:, :, 1]
    apart = offset.norm(dim=-1)
    both = seen.all(-1)
    facts = torch.stack(
        [
            both.float(),
            seen[..., 0].float(),
            torch.where(both, torch.exp(-apart / 0.03), 0.0),
            torch.where(both, torch.sigmoid((_SUPPORTS_M - apart) / 0.004), 0.0),
            torch.where(seen[..., 0], rise[:, :, 0], 0.0),
        ],
        -1,
    )
    count = len(table.entities)
    has = roles(goal, count).view(len(table), count, CONJUNCTS, 2, 1)
    return (has * facts[:, None, :, None]).flatten(2)


def stick_state(table: SceneTable, ready: Tensor) -> Tensor:
    """Return the stick's pose relative to each movable entity, (B, E, 8).

    Args:
        table: B scenes.
        ready: Position of each entity in the gripper's frame when the stick lies ready,
            (S, E, 2) [m].
    """
    yaw = table.yaw[:, table.stick, None]
    x, y = (table.xy - table.grasp[:, None]).unbind(-1)
    u, v = x * yaw.cos() + y * yaw.sin(), y * yaw.cos() - x * yaw.sin()
    both = table.present & table.present[:, table.stick, None]
    numbers = torch.arange(len(table.entities), device=yaw.device)
    both = both & (numbers < table.cargo)
    found = []
    for ahead, across in (one.unbind(-1) for one in ready):
        du, dv = u - ahead, v - across
        off = torch.maximum(du.abs(), dv.abs())
        found += [(du / 0.1).tanh(), (dv / 0.1).tanh(), torch.exp(-off / 0.05)]
        found.append(torch.sigmoid((0.025 - off) / 0.005))
    return torch.where(both[..., None], torch.stack(found, -1), 0.0)


def drag_features(values: Tensor, count: int) -> Tensor:
    """Return features of the best drag of each entity, (B, E, R * S * 3).

    Args:
        values: Values for each moved object, (B, R, S, C, 3).
        count: E.
    """
    flat = (values / 5.0).tanh().permute(0, 3, 1, 2, 4).flatten(2)
    return F.pad(flat, (0, 0, 0, count - flat.shape[1]))


def tool_features(values: Tensor, table: SceneTable, use_reach: bool) -> Tensor:
    """Return features of every sub-task with the stick, (B, 4, C, R, 7)."""
    per = values.permute(0, 2, 3, 1, 4)[:, constant(_SIDE_OF, values.device)]
    margins = table.detached().margins(table.grasp.detach()[:, None]).squeeze(-1)
    if not use_reach:
        margins = torch.zeros_like(margins)
    grip = torch.stack([(margins / 0.02).tanh(), (margins / 0.15).tanh()], -1)
    grip = grip[:, None, None].expand(-1, *per.shape[1:4], -1)
    return torch.cat([(per / 5).tanh(), (per[..., 1:] / 1.0).tanh(), grip], -1)


def nearness(table: SceneTable) -> Tensor:
    """Return the spatial relations of entities, (B, E, E, RELATIONS)."""
    places = table.xy.detach()
    both = table.present[:, :, None] & table.present[:, None]
    offset = places[:, :, None] - places[:, None]
    apart = offset.norm(dim=-1)
    centres = constant(_DISTANCES_M, apart.device)
    widths = 0.5 * centres.clamp(min=0.03)
    bumps = torch.exp(-(((apart[..., None] - centres) / widths) ** 2))
    top = table.top.detach()
    rise = (top[:, :, None] - top[:, None]) / _UNIT_M
    close = torch.sigmoid((_SUPPORTS_M - apart) / 0.004)
    numbers = torch.arange(len(table.entities), device=apart.device)
    is_cargo = numbers < table.cargo
    kinds = torch.stack([is_cargo, ~is_cargo & (numbers < table.stick)], -1).float()
    pairs = kinds[:, None, :, None] * kinds[None, :, None, :]
    found = torch.cat([bumps, close[..., None], rise.clamp(-3, 3)[..., None]], -1)
    found = torch.where(both[..., None], found, 0.0)
    return torch.cat([found, pairs.flatten(2).expand(len(table), -1, -1, -1)], -1)


def recent(past: Tensor, count_of_entities: int) -> Tensor:
    """Return the most recent sub-tasks with each entity, (B, E, 7 * _RECENT)."""
    count = (past[..., 1] != NOBODY).sum(1)
    found = []
    for back in range(1, _RECENT + 1):
        index = (count - back).clamp(min=0)
        step = past[torch.arange(len(past), device=past.device), index]
        step = torch.where((count >= back)[:, None], step, NOBODY)
        _, primitive, pick, place = step.unbind(-1)
        numbers = torch.arange(count_of_entities, device=past.device)
        picked = (pick[:, None] == numbers).float()[..., None]
        placed = (place[:, None] == numbers).float()[..., None]
        what = F.one_hot(primitive.clamp(min=0), len(PRIMITIVES))[:, None, :5].float()
        found += [picked, placed, what * torch.maximum(picked, placed)]
    return torch.cat(found, -1)


def last(past: Tensor, robots: int) -> Tensor:
    """Return the last primitive and its robot, one-hot, (B, primitives + robots)."""
    count = (past[..., 1] != NOBODY).sum(1)
    step = past[torch.arange(len(past), device=past.device), (count - 1).clamp(min=0)]
    done = (count > 0).float()[:, None]
    primitive = F.one_hot(step[:, 1].clamp(min=0), len(PRIMITIVES))
    robot = F.one_hot(step[:, 0].clamp(min=0), robots)
    return torch.cat([primitive, robot], -1) * done
