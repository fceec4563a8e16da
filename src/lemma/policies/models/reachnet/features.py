"""What ReachNet's planner knows of each entity and each robot: features of a table.

None of them says which color a thing has.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.batch import NOBODY, PRIMITIVES
from lemma.policies.models.reachnet.drags import SIGNS
from lemma.policies.models.reachnet.scene_table import (
    CONJUNCTS,
    CUBES,
    PADS,
    THE_STICK,
    SceneTable,
)

_C, _E = len(CUBES), len(CUBES) + len(PADS) + 1
_RECENT = 2
_DISTANCES_M = (0.0, 0.03, 0.07, 0.12, 0.25, 0.5, 1.0)
_SUPPORTS_M = 0.035
_FACE_M = 0.05

ROBOT_FEATURES = 8
_SIDE_OF = (0, 0, 1, 1)
PAIR = len(_DISTANCES_M) + 2
RELATIONS = PAIR + 4


def entity_feature_count(robots: int) -> int:
    """Return how many features an entity has."""
    goal_state = 2 * CONJUNCTS * 5
    drags = robots * len(SIGNS) * 3
    return 10 + 3 * robots + 2 * CONJUNCTS + goal_state + 8 + drags + 7 * _RECENT


def reach_features(table: SceneTable, use_reach: bool) -> Tensor:
    """Return how far inside each robot's reach each entity is, (B, 11, 3 R)."""
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
    overlap = rings[..., 1:] + rings.flip(1)[..., 1:] - gap
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
    """Return where each entity would be grasped, (B, 11, 2) [m]."""
    return torch.cat([table.xy[:, :THE_STICK], table.grasp[:, None]], 1)


def kinds(table: SceneTable) -> Tensor:
    """Return what each entity is and where, (B, 11, 10)."""
    kind = torch.zeros(len(table), _E, 3, device=table.xy.device)
    kind[:, CUBES, 0] = kind[:, PADS, 1] = kind[:, THE_STICK, 2] = 1.0
    there = table.present[..., None].float()
    level = (table.top - _FACE_M)[..., None] / _FACE_M
    heading = torch.stack([table.yaw.cos(), table.yaw.sin()], -1) * kind[..., 2:]
    xy = torch.where(table.present[..., None], table.xy, 0.0)
    away = xy.norm(dim=-1, keepdim=True)
    return torch.cat(
        [kind, there, xy, level * there * kind[..., :1], heading, away], -1
    )


def roles(goal: Tensor) -> Tensor:
    """Return each entity's roles in the goal, (B, 11, 2 * conjuncts)."""
    hot = F.one_hot(torch.where(goal == NOBODY, _E, goal), _E + 1)[..., :_E]
    return hot.flatten(1, 2).transpose(1, 2).float()


def goal_state(table: SceneTable, goal: Tensor) -> Tensor:
    """Return where each role's partner is, (B, 11, 2 * conjuncts * 5)."""
    index = goal.clamp(min=0)
    named = goal != NOBODY
    rows = torch.arange(len(table), device=goal.device)[:, None, None]
    xy, top = table.xy[rows, index], table.top[rows, index]
    seen = table.present[rows, index] & named
    offset = xy[:, :, 0] - xy[:, :, 1]
    apart = offset.norm(dim=-1)
    both = seen.all(-1)
    rise = (top[:, :, 0] - _FACE_M) / _FACE_M
    facts = torch.stack(
        [
            both.float(),
            seen[..., 0].float(),
            torch.where(both, torch.exp(-apart / 0.03), 0.0),
            torch.where(both, torch.sigmoid((_SUPPORTS_M - apart) / 0.004), 0.0),
            torch.where(seen[..., 0], rise, 0.0),
        ],
        -1,
    )
    has = roles(goal).view(len(table), _E, CONJUNCTS, 2, 1)
    return (has * facts[:, None, :, None]).flatten(2)


def stick_state(table: SceneTable, ready: Tensor) -> Tensor:
    """Return how the stick lies to each cube, (B, 11, 8)."""
    yaw = table.yaw[:, THE_STICK, None]
    x, y = (table.xy - table.grasp[:, None]).unbind(-1)
    u, v = x * yaw.cos() + y * yaw.sin(), y * yaw.cos() - x * yaw.sin()
    both = table.present & table.present[:, THE_STICK, None]
    is_cube = torch.arange(_E, device=yaw.device) < _C
    both = both & is_cube
    found = []
    for ahead, across in ready.unbind(0):
        du, dv = u - ahead, v - across
        off = torch.maximum(du.abs(), dv.abs())
        found += [(du / 0.1).tanh(), (dv / 0.1).tanh(), torch.exp(-off / 0.05)]
        found.append(torch.sigmoid((0.025 - off) / 0.005))
    return torch.where(both[..., None], torch.stack(found, -1), 0.0)


def drag_features(values: Tensor) -> Tensor:
    """Return what the stick can do with each cube, (B, 11, R * S * 3)."""
    flat = (values / 5.0).tanh().permute(0, 3, 1, 2, 4).flatten(2)
    return F.pad(flat, (0, 0, 0, _E - _C))


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
    """Return how entities lie to one another, (B, 11, 11, RELATIONS)."""
    places = table.xy.detach()
    both = table.present[:, :, None] & table.present[:, None]
    offset = places[:, :, None] - places[:, None]
    apart = offset.norm(dim=-1)
    centres = torch.tensor(_DISTANCES_M, device=apart.device)
    widths = 0.5 * centres.clamp(min=0.03)
    bumps = torch.exp(-(((apart[..., None] - centres) / widths) ** 2))
    top = table.top.detach()
    rise = (top[:, :, None] - top[:, None]) / _FACE_M
    close = torch.sigmoid((_SUPPORTS_M - apart) / 0.004)
    kinds = torch.zeros(_E, 2, device=apart.device)
    kinds[list(CUBES), 0] = kinds[list(PADS), 1] = 1.0
    pairs = kinds[:, None, :, None] * kinds[None, :, None, :]
    found = torch.cat([bumps, close[..., None], rise.clamp(-2, 2)[..., None]], -1)
    found = torch.where(both[..., None], found, 0.0)
    return torch.cat([found, pairs.flatten(2).expand(len(table), -1, -1, -1)], -1)


def recent(past: Tensor) -> Tensor:
    """Return what was last done with each entity, (B, 11, 7 * _RECENT)."""
    count = (past[..., 1] != NOBODY).sum(1)
    found = []
    for back in range(1, _RECENT + 1):
        index = (count - back).clamp(min=0)
        step = past[torch.arange(len(past), device=past.device), index]
        step = torch.where((count >= back)[:, None], step, NOBODY)
        _, primitive, pick, place = step.unbind(-1)
        numbers = torch.arange(_E, device=past.device)
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
