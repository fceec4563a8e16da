"""Robots of teams by color, and regions by their robots.

Rows of robots are numbered by color, because a robot's color is what pictures and
sentences tell of it. So a network has no weights for a robot's place in its team.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import torch
from torch import Tensor

from lemma.core.errors import InvalidConfigError
from lemma.core.robot_names import robot_name
from lemma.policies.batch import (
    NOBODY,
    PRIMITIVES,
    Batch,
    Labels,
    decision_numbers,
)
from lemma.policies.entities import EntitySet
from lemma.policies.layers import constant, sent
from lemma.policies.models.reachnet.scene_table import FAR_M
from lemma.robots.hand import STANDARD
from lemma.scene.objects.entity import SHARED, pair_regions
from lemma.scene.spec import ROBOT_COLORS
from lemma.tasks.subtask import STOP, Primitive, SubTask

ROBOTS = len(ROBOT_COLORS)
"""Number of colors of robots, and the largest size of a team."""
PAIRS = tuple(combinations(range(ROBOTS), 2))
"""Pairs of colors, in the order of the regions of pairs."""
REGIONS = (SHARED, *pair_regions(ROBOTS))
"""The region of all robots, and those of pairs."""
_MEMBERS = (
    (False,) * ROBOTS,
    *(tuple(color in pair for color in range(ROBOTS)) for pair in PAIRS),
)
"""Robots that a region needs, by color; the region of all needs no certain one."""


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
    return sent(torch.tensor(rows), device)


def named_colors(named: Sequence[Sequence[str]], device: torch.device) -> Tensor:
    """Return the color by which each color's robot is named, (B, R).

    Args:
        named: Colors of the robots of each scene, which may repeat in a pair.
        device: Device of the result.
    """
    rows = []
    for colors in named:
        row = list(range(ROBOTS))
        for own, color in zip(distinct(colors), colors, strict=True):
            row[ROBOT_COLORS.index(own)] = ROBOT_COLORS.index(color)
        rows.append(row)
    return sent(torch.tensor(rows), device)


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


def members(team: Tensor) -> Tensor:
    """Return whether robots belong to regions, (B, regions, R) bool."""
    pairs = constant(_MEMBERS[1:], team.device).expand(len(team), -1, -1)
    return torch.cat([team[:, None], pairs & team[:, None]], 1)


def weak_hands(
    hands: Sequence[Sequence[str]], teams: Sequence[Sequence[str]], device: torch.device
) -> Tensor:
    """Return whether robots have another hand than the standard one, (B, R) bool."""
    rows = []
    for names, team in zip(hands, teams, strict=True):
        held = dict(zip(team, names, strict=False))
        rows.append([held.get(color, STANDARD) != STANDARD for color in ROBOT_COLORS])
    return sent(torch.tensor(rows), device)


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


def colored(batch: Batch, numbers: Tensor) -> tuple[Batch, Labels | None]:
    """Return a batch with rows of robots by color, and its labels.

    Args:
        batch: Rows in the order of the team.
        numbers: From :func:`numbers_by_color`.
    """
    labels = batch.labels and replace(
        batch.labels,
        bases=by_color(batch.labels.bases, numbers, FAR_M),
        arms=by_color(batch.labels.arms, numbers).long(),
    )
    joints = by_color(batch.joints, numbers)
    return replace(batch, joints=joints, labels=labels), labels


def numbers_of(subtask: SubTask, team: Sequence[str], entities: EntitySet) -> Tensor:
    """Return a move as numbers, (1, 3)."""
    numbers = decision_numbers(subtask.to_dict(), entities)
    return torch.tensor([move_numbers(numbers, team, entities)])


def move_named(
    move: Sequence[int], team: Sequence[str], entities: EntitySet
) -> SubTask:
    """Return the sub-task of a move's numbers; ``stop`` for -1."""
    robot, pick, place = move
    if robot < 0:
        return STOP
    region = place - len(entities)
    where = entities.names[place] if region < 0 else region_name(region, team)
    who = robot_name(team.index(ROBOT_COLORS[robot]))
    return SubTask(who, Primitive.MOVE, entities.names[pick], where)
