"""ReachNet's planner: from a table, a goal and the past to the next sub-task.

It scores every sub-task that there is, for every robot. Colors are no input: entities
differ by their kind, their place and their role in the goal, so that what is learned of
one color holds for all. A score is a learned function of the context plus, as in the
paper's utility, the logarithm of how likely the robot reaches what it needs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Depth, Share, Width
from lemma.core.robot_names import robot_name
from lemma.policies.batch import NOBODY, PRIMITIVES, STOP, decision_numbers
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.interfaces import PolicyInput
from lemma.policies.layers import TransformerLayer, drawn
from lemma.policies.models.reachnet.drags import DragUtility
from lemma.policies.models.reachnet.features import (
    PAIR,
    RELATIONS,
    ROBOT_FEATURES,
    drag_features,
    entity_feature_count,
    goal_state,
    kinds,
    last,
    nearness,
    places,
    reach_features,
    recent,
    robot_features,
    roles,
    stick_state,
    tool_features,
)
from lemma.policies.models.reachnet.scene_table import SceneTable
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import Primitive, SubTask

_TOOL_ROWS = ("prehook", "hook", "prepoke", "poke")
_ROW_OF = {PRIMITIVES.index(name): row for row, name in enumerate(_TOOL_ROWS)}
_ABSENT = -20.0
_SUCCESS = "success"
_OPTIONS = 6


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
    """Share of values left out in training."""
    past_dropout: Share = 0.5
    """Share of frames whose past is left out in training: what lies on the table says
    nearly all, and a policy that trusts its past does not see when it failed."""


class ReachNetPlanner(nn.Module):
    """Scores sub-tasks."""

    def __init__(self, config: PlannerConfig, robots: int, use_reach: bool) -> None:
        """Make the weights.

        Args:
            config: Options.
            robots: Robots of a team.
            use_reach: Whether reach is known.
        """
        super().__init__()
        self.config, self.robots, self.use_reach = config, robots, use_reach
        width = config.width
        self.entity_in = _mlp(entity_feature_count(robots), width, width)
        self.robot_in = _mlp(ROBOT_FEATURES, width, width)
        self.whole = drawn(2, width)
        self.numbers = drawn(robots, width)
        self.past_in = nn.Linear(len(PRIMITIVES) + robots, width)
        self.relation = _mlp(RELATIONS, 32, config.heads)
        self.layers = nn.ModuleList(
            TransformerLayer(
                width,
                config.heads,
                4 * width,
                config.dropout,
                F.silu,
                drops_hidden=False,
            )
            for _ in range(config.layers)
        )
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
        self.hand_over = _mlp(2 * width, width, 1)
        self.stop = _mlp(width, width, 1)
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
            drags: Computes which drags the stick can do.
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
        """Return what is added to the attention, (B, heads, L, L)."""
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
        """Exclude sub-tasks that are impossible for every model.

        Things that are not there or that no gripper holds are not moved, nor onto
        things that bear nothing.
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


def _mlp(wide: int, hidden: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(wide, hidden), nn.SiLU(), nn.Linear(hidden, out))


def number_of(decision: Tensor, robots: int, entities: EntitySet = BENCHMARK) -> Tensor:
    """Return the number of sub-tasks among all, (B,).

    Args:
        decision: Robot, primitive, pick, place, (B, 4).
        robots: Robots of a team.
        entities: Entities, in the order of their numbers.
    """
    robot, primitive, pick, place = decision.unbind(-1)
    cargo, stick, spots = entities.cargo, entities.stick, entities.stick + 1
    spot = torch.where(place == entities.shared, stick, place)
    moves = cargo * spots * robots
    rows = torch.zeros(len(PRIMITIVES), dtype=torch.int64, device=decision.device)
    for known, row in _ROW_OF.items():
        rows[known] = row
    move = (pick * spots + spot) * robots + robot
    tool = moves + (rows[primitive] * cargo + place) * robots + robot
    tools = moves + len(_TOOL_ROWS) * cargo * robots
    hand = tools + robot
    number = torch.where(primitive == 0, torch.where(pick == stick, hand, move), tool)
    return torch.where(primitive == STOP, tools + robots, number)


def decision_of(number: Tensor, robots: int, entities: EntitySet = BENCHMARK) -> Tensor:
    """Return the sub-tasks of numbers, (B, 4): the inverse of :func:`number_of`."""
    cargo, stick, spots = entities.cargo, entities.stick, entities.stick + 1
    shared = entities.shared
    moves = cargo * spots * robots
    tools = moves + len(_TOOL_ROWS) * cargo * robots
    robot, rest = number % robots, number // robots
    spot = rest % spots
    zero = torch.zeros_like(number)
    place = torch.where(spot == stick, shared, spot)
    move = torch.stack([robot, zero, rest // spots, place], -1)
    inner = (number - moves).clamp(min=0)
    row = (inner // robots // cargo).clamp(max=len(_TOOL_ROWS) - 1)
    primitives = torch.tensor(list(_ROW_OF), device=number.device)
    tool_robot, cube = inner % robots, inner // robots % cargo
    tool = torch.stack([tool_robot, primitives[row], zero + stick, cube], -1)
    hand_robot = (number - tools).clamp(0, robots - 1)
    hand = torch.stack([hand_robot, zero, zero + stick, zero + shared], -1)
    none = torch.stack([zero - 1, zero + STOP, zero - 1, zero - 1], -1)
    bands = (
        number[:, None]
        >= torch.tensor([moves, tools, tools + robots], device=number.device)
    ).sum(-1)
    table = torch.stack([move, tool, hand, none], 1)
    return table[torch.arange(len(number), device=number.device), bands]


def subtask_of(row: Sequence[int], entities: EntitySet = BENCHMARK) -> SubTask:
    """Return a sub-task of numbers: robot, primitive, pick, place."""
    places = entities.places
    robot, primitive, pick, place = row
    if primitive == STOP:
        return STOP_SUBTASK
    return SubTask(
        robot_name(robot), Primitive(PRIMITIVES[primitive]), places[pick], places[place]
    )


def likeliest(
    scores: Tensor, robots: int, entities: EntitySet = BENCHMARK
) -> list[tuple[tuple[SubTask, float], ...]]:
    """Return sub-tasks and how likely they are, for each of B scenes, likeliest first.

    Args:
        scores: Scores of every sub-task, (B, N).
        robots: Robots of a team.
        entities: Entities, in the order of their numbers.
    """
    shares, numbers = scores.float().softmax(-1).topk(_OPTIONS)
    return [
        tuple(
            (subtask_of(code, entities), share)
            for code, share in zip(
                decision_of(row, robots, entities).tolist(), each.tolist(), strict=True
            )
        )
        for row, each in zip(numbers, shares, strict=True)
    ]


def numbers_of(
    subtask: SubTask, robots: int, entities: EntitySet = BENCHMARK
) -> list[int]:
    """Return a sub-task as numbers; those of ``stop`` if it makes no sense."""
    nothing = [NOBODY, STOP, NOBODY, NOBODY]
    try:
        numbers = decision_numbers(subtask.to_dict(), entities)
    except ValueError:
        return nothing
    robot, _, pick, place = numbers
    cargo, stick = range(entities.cargo), entities.stick
    if subtask.primitive is Primitive.MOVE:
        onto = place in range(stick) and place != pick
        fits = (pick in cargo and (onto or place > stick)) or (
            pick == stick and place > stick
        )
    else:
        fits = pick == stick and place in cargo
    return numbers if fits and 0 <= robot < robots else nothing


def named_in(decision: Tensor, count: int) -> Tensor:
    """Return which of so many entities sub-tasks pick or act on, (B, E) bool."""
    numbers = torch.arange(count, device=decision.device)
    return (decision[:, 2:, None] == numbers).any(1)


def failures_in(given: PolicyInput) -> list[SubTask]:
    """Return what has failed since something last succeeded."""
    failed = []
    for step in reversed(given.past):
        if step.outcome == _SUCCESS:
            break
        failed.append(step.subtask)
    return failed
