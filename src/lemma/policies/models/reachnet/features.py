"""Features of each entity and each robot of a table, for ReachNet's planner.

They do not depend on the colors of things.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.batch import NOBODY, PRIMITIVES
from lemma.policies.models.reachnet.drags import SIGNS
from lemma.policies.models.reachnet.scene_table import CONJUNCTS, SceneTable

_RECENT = 2
_DISTANCES_M = (0.0, 0.03, 0.07, 0.12, 0.25, 0.5, 1.0)
_SUPPORTS_M = 0.035
_UNIT_M = 0.05
"""Unit of heights and radii of things [m]."""
_KIND = 8

ROBOT_FEATURES = 9
_SIDE_OF = (0, 0, 1, 1)
PAIR = len(_DISTANCES_M) + 2
RELATIONS = PAIR + 4


def entity_feature_count(robots: int) -> int:
    """Return how many features an entity has."""
    goal_state = 2 * CONJUNCTS * 5
    drags = robots * len(SIGNS) * 3
    state = 7 + 3 * robots + 2 * CONJUNCTS + goal_state + 8 + drags + 7 * _RECENT
    return _KIND + state


def reach_features(table: SceneTable, use_reach: bool) -> Tensor:
    """Return how far inside each robot's reach each entity is, (B, E, 3 R)."""
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
    """Return what is known of each robot, (B, R, ROBOT_FEATURES)."""
    rings = table.rings if use_reach else torch.zeros_like(table.rings)
    centre = torch.zeros(len(table), 1, 2, device=rings.device)
    shared = table.margins(centre).squeeze(-1)
    gap = (table.bases - table.bases.flip(1)).norm(dim=-1, keepdim=True)
    overlap = rings[..., 1:2] + rings.flip(1)[..., 1:2] - gap
    if not use_reach:
        shared, overlap = torch.zeros_like(shared), torch.zeros_like(overlap)
    return torch.cat(
        [
            table.bases,
            rings,
            gap,
            (overlap / 0.3).tanh(),
            (overlap / 0.05).tanh(),
            (shared[..., None] / 0.1).tanh(),
        ],
        -1,
    )


def places(table: SceneTable) -> Tensor:
    """Return where each entity would be grasped, (B, E, 2) [m]."""
    return torch.cat([table.xy[:, : table.stick], table.grasp[:, None]], 1)


def kinds(table: SceneTable) -> Tensor:
    """Return what each entity is, by its kind's record, and where, (B, E, 15)."""
    traits, count = table.traits, len(table.entities)
    numbers = torch.arange(count, device=table.xy.device)
    is_cargo, is_stick = numbers < table.cargo, numbers == table.stick
    sizes = torch.stack([traits.height_m, traits.disc_m, traits.support_m], -1)
    told = [is_cargo, is_stick, traits.graspable, traits.draggable, traits.faceted]
    kind = torch.cat([torch.stack(told, -1).float(), sizes / _UNIT_M], -1)
    there = table.present[..., None].float()
    level = (raised(table) / _UNIT_M)[..., None]
    heading = torch.stack([table.yaw.cos(), table.yaw.sin()], -1)
    heading = heading * is_stick[:, None]
    xy = torch.where(table.present[..., None], table.xy, 0.0)
    away = xy.norm(dim=-1, keepdim=True)
    kind = kind.expand(len(table), -1, -1)
    return torch.cat([kind, there, xy, level, heading, away], -1)


def raised(table: SceneTable) -> Tensor:
    """Return how high above the table what is moved lies, (B, E) [m]; 0 for the rest.

    The height of its top less its own is that of what it lies on.
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
    """Return where each role's partner is, (B, E, 2 * conjuncts * 5)."""
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
    """Return how the stick lies to each thing that is moved, (B, E, 8).

    Args:
        table: B scenes.
        ready: Where each entity is, seen from the gripper, when the stick lies ready,
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
    """Return what the stick can do with each entity, (B, E, R * S * 3).

    Args:
        values: Values for each moved object, (B, R, S, C, 3).
        count: E.
    """
    flat = (values / 5.0).tanh().permute(0, 3, 1, 2, 4).flatten(2)
    return F.pad(flat, (0, 0, 0, count - flat.shape[1]))


def tool_features(values: Tensor, table: SceneTable, use_reach: bool) -> Tensor:
    """Return the same for every sub-task with the stick, (B, 4, C, R, 7)."""
    per = values.permute(0, 2, 3, 1, 4)[:, _SIDE_OF, :]
    margins = table.detached().margins(table.grasp.detach()[:, None]).squeeze(-1)
    if not use_reach:
        margins = torch.zeros_like(margins)
    grip = torch.stack([(margins / 0.02).tanh(), (margins / 0.15).tanh()], -1)
    grip = grip[:, None, None].expand(-1, *per.shape[1:4], -1)
    return torch.cat([(per / 5).tanh(), (per[..., 1:] / 1.0).tanh(), grip], -1)


def nearness(table: SceneTable) -> Tensor:
    """Return how entities lie to one another, (B, E, E, RELATIONS)."""
    places = table.xy.detach()
    both = table.present[:, :, None] & table.present[:, None]
    offset = places[:, :, None] - places[:, None]
    apart = offset.norm(dim=-1)
    centres = torch.tensor(_DISTANCES_M, device=apart.device)
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
    """Return what was last done with each entity, (B, E, 7 * _RECENT)."""
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
    """Return the last primitive and its robot, (B, primitives + robots)."""
    count = (past[..., 1] != NOBODY).sum(1)
    step = past[torch.arange(len(past), device=past.device), (count - 1).clamp(min=0)]
    done = (count > 0).float()[:, None]
    primitive = F.one_hot(step[:, 1].clamp(min=0), len(PRIMITIVES))
    robot = F.one_hot(step[:, 0].clamp(min=0), robots)
    return torch.cat([primitive, robot], -1) * done
