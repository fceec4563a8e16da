"""Poses from CLIPort's heads, losses against the expert's, and how near they come."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.batch import PRIMITIVES, STOP, Labels
from lemma.policies.entities import BENCHMARK, EntitySet, traits_of
from lemma.policies.models.cliport.heads import (
    Attention,
    PickHead,
    PlaceHead,
    pick_cells,
    place_cells,
)
from lemma.policies.models.cliport.refinement import Zoom
from lemma.policies.models.cliport.rotations import nearest_bins, wrapped, yaw_of
from lemma.scene.raster import Raster

_YAW_WEIGHT = 0.5
_OFFSET_WEIGHT = 1.0
_RESIDUAL_WEIGHT = 1.0
_ZOOM_WEIGHT = 1.0

_NEAR_M = 0.02
_NEAR_SHARED_M = 0.06
_NEAR_PICK_YAW = math.radians(10.0)
_NEAR_PLACE_YAW = math.radians(8.0)
_LEAST_RAD = 1e-3
_MOVE = PRIMITIVES.index("move")


@dataclass(frozen=True)
class Poses:
    """Gripper where it closes and where its motion ends: x, y [m], yaw [rad]."""

    pick: Tensor
    """(B, 3)."""
    place: Tensor
    """(B, 3); its yaw is the pick's and at most half a turn."""


def picks(head: PickHead, seen: Attention, raster: Raster) -> tuple[Tensor, Tensor]:
    """Return the best pick poses, (B, 3), and the cells that hold them, (B,)."""
    cells = pick_cells(raster)
    numbers = seen.logits.argmax(1, keepdim=True)
    offsets, yaws, residuals = head.at(seen, numbers)
    best = yaws.argmax(-1, keepdim=True)
    residual = residuals.gather(-1, best)
    xy = cells.positions(numbers, offsets)
    yaw = yaw_of(best, residual, head.bins)
    return torch.cat([xy, yaw], -1)[:, 0], numbers[:, 0]


def places(
    head: PlaceHead,
    zoom: Zoom | None,
    seen: tuple[Tensor, Tensor],
    pick: Tensor,
    raster: Raster,
) -> Tensor:
    """Return the best place poses for pick poses, (B, 3).

    Args:
        head: Tries all places.
        zoom: Looks again at the best, if anybody does.
        seen: Picture and sentence.
        pick: Gripper where it closes, (B, 3).
        raster: Where the cells are.
    """
    cells = place_cells(raster)
    fit = head(*seen, pick, raster)
    best = fit.logits.flatten(1).argmax(1, keepdim=True)
    bin_number, number = best // len(cells), best % len(cells)
    offsets, residual = head.at(fit, number, bin_number, pick, cells)
    xy = cells.positions(number, offsets)[:, 0]
    place = torch.cat([xy, yaw_of(bin_number, residual, head.bins)], 1)
    if zoom is not None:
        place = zoom.corrected(place, zoom(seen, fit, pick, place, raster))
    # The arm turns from one to the other: never the long way round.
    yaw = pick[:, 2:] + wrapped(place[:, 2:] - pick[:, 2:])
    return torch.cat([place[:, :2], yaw], 1)


def counted(labels: Labels) -> tuple[Tensor, Tensor, Tensor]:
    """Return which frames have poses, (B,), and the poses; 0 where there are none."""
    counts = labels.decision[:, 1] != STOP
    return counts, labels.pick_pose.nan_to_num(), labels.place_pose.nan_to_num()


def mean_over(values: Tensor, counts: Tensor) -> Tensor:
    """Return the mean of one value a frame, (B,), over those that count."""
    return (values * counts).sum() / counts.sum().clamp(min=1)


def pick_losses(
    head: PickHead, seen: Attention, pick: Tensor, counts: Tensor, raster: Raster
) -> dict[str, Tensor]:
    """Return the losses of the pick.

    Args:
        head: Whose losses.
        seen: By the head.
        pick: The expert's, (B, 3).
        counts: Which frames count, (B,).
        raster: Where the cells are.
    """
    cells = pick_cells(raster)
    numbers = cells.holding(pick[:, :2])
    chosen = F.cross_entropy(seen.logits, numbers, reduction="none")
    near = cells.around(numbers)
    offsets, yaws, residuals = head.at(seen, near)
    wanted = cells.offsets(pick[:, None, :2], near)
    both, rests = nearest_bins(pick[:, 2], head.bins)
    yaw = F.cross_entropy(yaws[:, 4], both[:, 0], reduction="none")
    index = both[:, None].expand(-1, near.shape[1], -1)
    residual = F.smooth_l1_loss(
        residuals.gather(2, index), rests[:, None].expand(index.shape), reduction="none"
    )
    return {
        "pick": mean_over(chosen, counts),
        "pick_offset": _OFFSET_WEIGHT * mean_over(_distance(offsets, wanted), counts),
        "pick_yaw": _YAW_WEIGHT * mean_over(yaw, counts),
        "pick_residual": _RESIDUAL_WEIGHT * mean_over(residual.mean((1, 2)), counts),
    }


def place_losses(
    heads: tuple[PlaceHead, Zoom | None],
    seen: tuple[Tensor, Tensor],
    poses: Poses,
    counts: Tensor,
    raster: Raster,
) -> dict[str, Tensor]:
    """Return the losses of the place, after the expert's pick.

    Args:
        heads: Whose losses.
        seen: Picture and sentence.
        poses: The expert's.
        counts: Which frames count, (B,).
        raster: Where the cells are.
    """
    head, zoom = heads
    cells = place_cells(raster)
    fit = head(*seen, poses.pick, raster)
    xy = poses.place[:, :2]
    numbers = cells.holding(xy)
    both, rests = nearest_bins(poses.place[:, 2], head.bins)
    chosen = F.cross_entropy(
        fit.logits.flatten(1), both[:, 0] * len(cells) + numbers, reduction="none"
    )
    near = cells.around(numbers)
    count = near.shape[1]
    bin_numbers = both.repeat_interleave(count, 1)
    near = near.repeat(1, both.shape[1])
    offsets, residuals = head.at(fit, near, bin_numbers, poses.pick, cells)
    wanted = cells.offsets(xy[:, None], near)
    residual = F.smooth_l1_loss(
        residuals, rests.repeat_interleave(count, 1), reduction="none"
    )
    losses = {
        "place": mean_over(chosen, counts),
        "place_offset": _OFFSET_WEIGHT * mean_over(_distance(offsets, wanted), counts),
        "place_residual": _RESIDUAL_WEIGHT * mean_over(residual.mean(1), counts),
    }
    if zoom is not None:
        again = zoom.loss(seen, fit, poses.pick, poses.place, raster)
        losses["place_zoom"] = _ZOOM_WEIGHT * mean_over(again, counts)
    return losses


def _distance(offsets: Tensor, wanted: Tensor) -> Tensor:
    return F.smooth_l1_loss(offsets, wanted, reduction="none", beta=0.5).mean((1, 2))


def score_poses(
    found: Poses, labels: Labels, entities: EntitySet = BENCHMARK
) -> dict[str, Tensor]:
    """Return how near poses come to the expert's, (B,) each; NaN for ``stop``.

    ``grounded`` says whether pick and place are right, in all frames and in those of
    each primitive.

    A pick is right within 2 cm and 10 degrees, where half a turn makes no difference,
    and a quarter turn none of a cube; a place within 2 cm, with the stick also within
    8 degrees, and within 6 cm where anything in the shared space will do. Round
    objects may be held from any side.

    Args:
        found: Predicted poses.
        labels: The expert's.
        entities: Whose numbers the labels have.
    """
    counts, pick, place = counted(labels)
    _, primitive, entity, goal = labels.decision.unbind(1)
    turns = traits_of(entities, pick.device).turn_rad[entity.clamp(min=0)]
    is_stick = entity == entities.stick
    pick_m = (found.pick[:, :2] - pick[:, :2]).norm(dim=1)
    pick_yaw = _apart(found.pick[:, 2] - pick[:, 2], turns)
    place_m = (found.place[:, :2] - place[:, :2]).norm(dim=1)
    # The held object turns by the difference.
    turn = (found.place[:, 2] - found.pick[:, 2]) - (place[:, 2] - pick[:, 2])
    held = torch.where(is_stick, 2 * math.pi, turns)
    place_yaw = _apart(turn, held) + torch.where(is_stick, pick_yaw, 0.0)
    near_m = torch.where(goal == entities.shared, _NEAR_SHARED_M, _NEAR_M)
    right_pick = (pick_m < _NEAR_M) & (pick_yaw < _NEAR_PICK_YAW)
    right_place = (place_m < near_m) & (
        (primitive == _MOVE) | (place_yaw < _NEAR_PLACE_YAW)
    )
    right = (right_pick & right_place).float()
    by_primitive = {
        f"grounded_{name}": right.where(primitive == number, math.nan)
        for number, name in enumerate(PRIMITIVES)
        if number != STOP
    }
    scores = {
        **by_primitive,
        "grounded": right,
        "right_pick": right_pick.float(),
        "right_place": right_place.float(),
        "minus_pick_mm": -1000.0 * pick_m,
        "minus_place_mm": -1000.0 * place_m,
        "minus_place_deg": -torch.rad2deg(place_yaw),
    }
    return {name: value.where(counts, math.nan) for name, value in scores.items()}


def _apart(angle: Tensor, symmetry: Tensor) -> Tensor:
    """Return how far an angle is from the next multiple of a symmetry [rad].

    Args:
        angle: [rad], (B,).
        symmetry: [rad], (B,); 0 where any angle looks the same.
    """
    turn = symmetry.clamp(min=_LEAST_RAD)
    return (torch.remainder(angle + turn / 2, turn) - turn / 2).abs()
