"""How good ReachNet's decisions are, frame by frame, and how likely its reach is."""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.batch import NOBODY, PRIMITIVES, Labels
from lemma.policies.entities import BENCHMARK, EntitySet, traits_of
from lemma.policies.models.reachnet.grounder import dragged
from lemma.policies.models.reachnet.scene_table import SceneTable
from lemma.scene.raster import Raster

_PICK_M, _ON_M, _SHARED_M = 0.02, 0.02, 0.06
_YAW_RAD, _BEARING_RAD = math.radians(10.0), math.radians(4.0)
_LENGTH_M = 0.03
_EDGE_M = 0.05
_LEAST_RAD = 1e-3
_REACH_EDGE_M = 0.006
_TIGHT = 0.2
_DEMONSTRATED = 0.3
_PREPARE = (PRIMITIVES.index("prehook"), PRIMITIVES.index("prepoke"))
_USE = (PRIMITIVES.index("hook"), PRIMITIVES.index("poke"))

Poses = tuple[Tensor, Tensor]
"""Gripper where it closes and where the motion ends, (B, 3) each."""


def score_decisions(
    decision: Tensor,
    poses: Poses,
    told: Poses,
    labels: Labels,
    entities: EntitySet = BENCHMARK,
) -> dict[str, Tensor]:
    """Return scores by name, (B,); NaN where a frame does not count.

    Args:
        decision: Predicted decisions, (B, 4).
        poses: Poses for these decisions.
        told: Poses for the decisions of the demonstration.
        labels: The demonstration.
        entities: Entities, in the order of their numbers.
    """
    right = labels.decision
    acts = right[:, 0] != NOBODY
    same = decision == right
    plan = same.all(1)
    placed = _placed(told[1], labels, entities)
    picked = _picked(told[0], labels, entities)
    own = _picked(poses[0], labels, entities) & _placed(poses[1], labels, entities)
    prepares = (right[:, 1] == _PREPARE[0]) | (right[:, 1] == _PREPARE[1])
    bearing = _off(told[1][:, 2], labels.place_pose[:, 2], math.tau) < _BEARING_RAD
    return {
        "primitive": same[:, 1].float(),
        "pick": _only(same[:, 2], acts),
        "place": _only(same[:, 3], acts),
        "robot": _only(same[:, 0], acts),
        "plan": plan.float(),
        "pick_2cm": _only(picked, acts),
        "place_pose": _only(placed, acts),
        "bearing": _only(bearing, prepares),
        "decision": (plan & (own | ~acts)).float(),
    }


def score_eye(
    table: SceneTable, truth: SceneTable, raster: Raster
) -> dict[str, Tensor]:
    """Return how good is what was seen, by name, (B,).

    Args:
        table: Predicted scene.
        truth: True scene.
        raster: Raster of the map.
    """
    both = table.present & truth.present
    off = (table.xy - truth.xy).norm(dim=-1)
    millimetres = torch.where(both, off, torch.nan).nanmean(1)
    share = torch.linspace(-0.36, 0.36, 25, device=off.device)
    width, depth = raster.size_m
    points = torch.cartesian_prod(share * width, share * depth)
    points = points.expand(len(off), -1, -1)
    true = truth.margins(points)
    agree = ((table.margins(points) > 0) == (true > 0)).float()
    clear = true.abs() > _EDGE_M
    return {
        "present": (table.present == truth.present).all(1).float(),
        "near": torch.exp(-millimetres / 0.01),
        "reach": (agree * clear).flatten(1).sum(1) / clear.flatten(1).sum(1),
    }


def _only(values: Tensor, counts: Tensor) -> Tensor:
    return torch.where(counts, values.float(), torch.nan)


def _picked(pose: Tensor, labels: Labels, entities: EntitySet) -> Tensor:
    """Return whether a gripper would grasp what it shall."""
    apart: Tensor = (pose[:, :2] - labels.pick_pose[:, :2]).norm(dim=1)
    # A cube is as well grasped by its other faces, and what is round in any way.
    turns = traits_of(entities, pose.device).turn_rad
    turn = turns[labels.decision[:, 2].clamp(min=0)].clamp(min=_LEAST_RAD)
    off = pose[:, 2] - labels.pick_pose[:, 2]
    off = (off - turn * torch.round(off / turn)).abs()
    return (apart < _PICK_M) & (off < _YAW_RAD)


def _placed(pose: Tensor, labels: Labels, entities: EntitySet) -> Tensor:
    """Return whether a motion would end where it shall."""
    _, primitive, pick, place = labels.decision.unbind(1)
    distance: Tensor = (pose[:, :2] - labels.place_pose[:, :2]).norm(dim=1)
    yaw, wanted = pose[:, 2], labels.place_pose[:, 2]
    prepares = (primitive == _PREPARE[0]) | (primitive == _PREPARE[1])
    uses = (primitive == _USE[0]) | (primitive == _USE[1])
    shared, faceted = place == entities.shared, traits_of(entities, yaw.device).faceted
    limit = torch.where(shared, _SHARED_M, _ON_M)
    limit = torch.where(uses, _LENGTH_M, limit)
    near = distance < limit
    square = _off(yaw, wanted, 0.5 * math.pi) < _YAW_RAD
    straight = _off(yaw, wanted, math.tau) < _BEARING_RAD
    # With the stick, a place is what it acts on: its yaw is looked at below.
    known = place.clamp(0, entities.stick)
    by_faces = (pick != entities.stick) & faceted[pick.clamp(min=0)]
    by_faces = by_faces & ~shared & faceted[known]
    good = torch.where(by_faces, square, torch.ones_like(square))
    good = torch.where(prepares, straight, good)
    return near & good


def _off(yaw: Tensor, wanted: Tensor, turn: float) -> Tensor:
    """Return the difference of angles of something that a turn makes the same."""
    off = yaw - wanted
    return (off - turn * torch.round(off / turn)).abs()


def demonstrated_reach(seen: SceneTable, labels: Labels) -> Tensor:
    """Return how unlikely it is, by reach alone, that these robots did it.

    The robot that acted reached both ends, and of the robots it was the likelier one.
    Demonstrations do not show where else a robot reaches: the smallest ring that holds
    all that was done is the likeliest, as if points were drawn evenly from it.
    """
    robot = labels.decision[:, 0].clamp(min=0)
    ends = torch.stack([labels.pick_pose[:, :2], labels.place_pose[:, :2]], 1)
    ends = ends.nan_to_num()
    drags = dragged(labels.decision[:, 1])[:, None]
    margins = seen.margins(ends)
    # An object that was lifted elsewhere is released low.
    held = seen.margins(ends[:, 1], low=True)
    margins = torch.stack(
        [margins[..., 0], torch.where(drags, held, margins[..., 1])], -1
    )
    logs = F.logsigmoid(margins / _REACH_EDGE_M).sum(-1)
    rows = torch.arange(len(robot), device=robot.device)
    likely = logs.log_softmax(1)[rows, robot] + logs[rows, robot]
    acts = labels.decision[:, 0] != NOBODY
    unlikely = torch.where(acts, -likely, 0.0).sum() / acts.sum().clamp(min=1)
    area = seen.rings[..., 1:].square() - seen.rings[..., :1].square()
    return _DEMONSTRATED * (unlikely + _TIGHT * area.log().mean())
