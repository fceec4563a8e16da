"""How good ReachNet's decisions are, frame by frame."""

import math

import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, PRIMITIVES, Labels
from lemma.policies.models.reachnet.scene_table import CUBES, THE_STICK
from lemma.scene.objects.entity import ENTITIES

_PICK_M, _ON_M, _SHARED_M = 0.02, 0.02, 0.06
_YAW_RAD, _BEARING_RAD = math.radians(10.0), math.radians(4.0)
_LENGTH_M = 0.03
_SHARED = len(ENTITIES)
_PREPARE = (PRIMITIVES.index("prehook"), PRIMITIVES.index("prepoke"))
_USE = (PRIMITIVES.index("hook"), PRIMITIVES.index("poke"))

Poses = tuple[Tensor, Tensor]
"""Gripper where it closes and where the motion ends, (B, 3) each."""


def score_decisions(
    decision: Tensor, poses: Poses, told: Poses, labels: Labels
) -> dict[str, Tensor]:
    """Return scores by name, (B,); NaN where a frame does not count.

    Args:
        decision: What was decided, (B, 4).
        poses: For that.
        told: For what the demonstration did.
        labels: The demonstration.
    """
    right = labels.decision
    acts = right[:, 0] != NOBODY
    same = decision == right
    plan = same.all(1)
    placed = _placed(told[1], labels)
    picked = _picked(told[0], labels)
    own = _picked(poses[0], labels) & _placed(poses[1], labels)
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


def _only(values: Tensor, counts: Tensor) -> Tensor:
    return torch.where(counts, values.float(), torch.nan)


def _picked(pose: Tensor, labels: Labels) -> Tensor:
    """Return whether a gripper would grasp what it shall."""
    apart: Tensor = (pose[:, :2] - labels.pick_pose[:, :2]).norm(dim=1)
    # A cube is as well grasped by its other faces.
    turn = torch.where(labels.decision[:, 2] == THE_STICK, math.pi, 0.5 * math.pi)
    off = pose[:, 2] - labels.pick_pose[:, 2]
    off = (off - turn * torch.round(off / turn)).abs()
    return (apart < _PICK_M) & (off < _YAW_RAD)


def _placed(pose: Tensor, labels: Labels) -> Tensor:
    """Return whether a motion would end where it shall."""
    _, primitive, pick, place = labels.decision.unbind(1)
    distance: Tensor = (pose[:, :2] - labels.place_pose[:, :2]).norm(dim=1)
    yaw, wanted = pose[:, 2], labels.place_pose[:, 2]
    prepares = (primitive == _PREPARE[0]) | (primitive == _PREPARE[1])
    uses = (primitive == _USE[0]) | (primitive == _USE[1])
    shared, stick = place == _SHARED, pick == THE_STICK
    limit = torch.where(shared, _SHARED_M, _ON_M)
    limit = torch.where(uses, _LENGTH_M, limit)
    near = distance < limit
    square = _off(yaw, wanted, 0.5 * math.pi) < _YAW_RAD
    straight = _off(yaw, wanted, math.tau) < _BEARING_RAD
    on_cube = ~stick & (place < len(CUBES))
    good = torch.where(on_cube, square, torch.ones_like(square))
    good = torch.where(prepares, straight, good)
    return near & good


def _off(yaw: Tensor, wanted: Tensor, turn: float) -> Tensor:
    """Return the difference of angles of something that a turn makes the same."""
    off = yaw - wanted
    return (off - turn * torch.round(off / turn)).abs()
