"""Augmentation of batches, with exact labels.

All frames of an episode get the same changes, because models see them together.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.batch import NOBODY, Batch, with_sub_instructions
from lemma.policies.layers import sent
from lemma.policies.models.grid import wrapped
from lemma.policies.models.reachnet.scene_table import turned_numbers
from lemma.policies.training.config import Augmentation
from lemma.policies.training.recoloring import permute_colors

HOLE_CELLS = (2, 8)
"""Smallest and largest side of a hole in the images."""
_EDGE_M = 0.06
"""Smallest distance of a motion and its objects from the edges of a rotated map."""


def augment(batch: Batch, options: Augmentation, rng: np.random.Generator) -> Batch:
    """Return a randomly augmented batch; instructions are drawn elsewhere.

    Args:
        batch: Batch with labels; only its maps may be on a GPU.
        options: Changes to draw.
        rng: Random generator.
    """
    assert batch.labels is not None
    episodes, numbers = np.unique(batch.labels.episode, return_inverse=True)
    count, device = len(episodes), batch.rgb.device

    def each(values: Any) -> Tensor:
        """Expand values of the episodes to values of the frames."""
        return torch.from_numpy(np.asarray(values)[numbers])

    if options.palette:
        colors = len(batch.entities.colors)
        batch = permute_colors(
            batch, each(rng.permuted(np.tile(np.arange(colors), (count, 1)), axis=1))
        )
    if options.rotate_deg:
        drawn = np.radians(options.rotate_deg) * rng.uniform(-1.0, 1.0, count)
        batch = rotate(batch, _kept_on_the_map(batch, each(drawn.astype(np.float32))))
    cells = options.translate_cells
    if options.turn or cells:
        shift = rng.integers(-cells, cells + 1, (count, 2))
        turned = rng.random(count) < 0.5 * options.turn
        batch = move(batch, each(shift), each(turned))
    generator = torch.Generator(device)
    generator.manual_seed(int(rng.integers(2**62)))
    if options.brightness or options.pixel_noise:
        amounts = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
        amounts_there = sent(each(amounts), device)
        batch = _noisy_colors(batch, options, amounts_there, generator)
    if options.height_noise_m:
        amount = rng.uniform(0.0, options.height_noise_m, count).astype(np.float32)
        batch = _noisy_heights(batch, sent(each(amount), device), generator)
    if options.dropouts:
        batch = _with_holes(batch, options.dropouts, rng)
    return with_sub_instructions(batch)


def rotate(batch: Batch, angle: Tensor) -> Batch:
    """Return a batch with scenes rotated about the middle of the map.

    Cells are copied from the nearest ones. Cells that enter at the border are not
    covered.

    Args:
        batch: Batch with labels; only its maps may be on a GPU.
        angle: Rotation of each frame, counter-clockwise, (B,) [rad].
    """
    labels = batch.labels
    assert labels is not None
    half, objects = 0.5 * angle[:, None], labels.objects
    spun = _spun(objects[..., 3:], half.cos(), half.sin())
    xy = _rotated(objects[..., :2], angle)

    def flat(poses: Tensor) -> Tensor:
        """Return poses (B, ..., 3) in the plane after the rotation."""
        yaw = poses[..., 2] + angle.view(-1, *(1,) * (poses.ndim - 2))
        return torch.cat([_rotated(poses[..., :2], angle), wrapped(yaw)[..., None]], -1)

    rotated = replace(
        labels,
        pick_pose=flat(labels.pick_pose),
        place_pose=flat(labels.place_pose),
        objects=torch.cat([xy, objects[..., 2:3], spun], -1),
        bases=flat(labels.bases),
    )
    return replace(_with_rotated_maps(batch, angle), labels=rotated)


def _kept_on_the_map(batch: Batch, angle: Tensor) -> Tensor:
    """Return the angles, zero for episodes that a rotation would spoil.

    A gap stays parallel to y, and the first robot of a pair at -x of the second. The
    next motion and its objects stay on the map, also after a shift.
    """
    labels = batch.labels
    assert labels is not None
    # Of regions and of no entity the last row is taken, which is NaN.
    places = F.pad(labels.objects[..., :2], (0, 0, 0, 1), value=torch.nan)
    named, none = labels.decision[:, 2:], places.shape[1] - 1
    named = torch.where(named == NOBODY, none, named).clamp(max=none)
    objects = places.gather(1, named[..., None].expand(-1, -1, 2))
    ends = torch.stack([labels.pick_pose, labels.place_pose], 1)[..., :2]
    most = 0.5 * torch.tensor(batch.raster.size_m) - _EDGE_M
    # NaN is never outside.
    outside = _rotated(torch.cat([objects, ends], 1), angle).abs() > most
    spoiled = outside.flatten(1).any(1) | labels.gap_m.isfinite().any(1)
    if labels.bases.shape[1] == 2:
        first_x, second_x = _rotated(labels.bases[..., :2], angle)[..., 0].unbind(1)
        spoiled |= first_x >= second_x
    spoiled = torch.isin(labels.episode, labels.episode[spoiled])
    return torch.where(spoiled, 0.0, angle)


def _rotated(xy: Tensor, angle: Tensor) -> Tensor:
    """Return positions (B, ..., 2) after a rotation of each frame, (B,) [rad]."""
    angle = angle.view(-1, *(1,) * (xy.ndim - 2))
    x, y = xy.unbind(-1)
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([cos * x - sin * y, sin * x + cos * y], -1)


def _with_rotated_maps(batch: Batch, angle: Tensor) -> Batch:
    raster, device = batch.raster, batch.rgb.device
    # In cells, with y upwards.
    column = torch.arange(raster.columns, device=device) + 0.5 - raster.columns / 2
    row = raster.rows / 2 - torch.arange(raster.rows, device=device) - 0.5
    grid = torch.stack(torch.meshgrid(column, row, indexing="xy"), -1)
    source = _rotated(grid.expand(len(batch), -1, -1, -1), sent(-angle, device))
    columns = torch.floor(source[..., 0] + raster.columns / 2).long()
    rows = torch.floor(raster.rows / 2 - source[..., 1]).long()
    seen = (rows >= 0) & (rows < raster.rows) & (columns >= 0)
    seen &= columns < raster.columns
    rows, columns = rows.clamp(0, raster.rows - 1), columns.clamp(0, raster.columns - 1)
    return _copied(batch, rows, columns, seen)


def _copied(batch: Batch, rows: Tensor, columns: Tensor, seen: Tensor) -> Batch:
    """Return a batch whose maps are copied from other cells, where those exist."""
    cells = torch.arange(len(batch), device=rows.device)[:, None, None], rows, columns
    return replace(
        batch,
        rgb=batch.rgb[cells] * seen[..., None],
        height_m=batch.height_m[cells] * seen,
        coverage=batch.coverage[cells] & seen,
    )


def _spun(quaternion: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Return quaternions wxyz after a rotation about z, (cos, 0, 0, sin)."""
    w, x, y, z = quaternion.unbind(-1)
    parts = [cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w]
    return torch.stack(parts, -1)


def move(batch: Batch, shift: Tensor, turned: Tensor) -> Batch:
    """Return a batch with scenes turned by half a turn, then shifted.

    In turned scenes the two robots of a pair exchange numbers, because the first robot
    is at -x; those of larger teams keep theirs. Cells that enter at the border are not
    covered.

    Args:
        batch: Batch with labels; only its maps may be on a GPU.
        shift: Shift along rows and columns in cells, (B, 2) int64.
        turned: Whether each frame is turned, (B,) bool.
    """
    labels, raster = batch.labels, batch.raster
    assert labels is not None
    robots = labels.bases.shape[1]
    swapped = turned & (robots == 2)
    sign = torch.where(turned, -1.0, 1.0)
    # Row numbers increase towards -y.
    offset = torch.stack([shift[:, 1], -shift[:, 0]], 1) * raster.cell_m

    def flat(poses: Tensor) -> Tensor:
        """Return the poses (B, ..., 3) in the plane after the motion."""
        extra = (1,) * (poses.ndim - 2)
        xy = poses[..., :2] * sign.view(-1, *extra, 1) + offset.view(-1, *extra, 2)
        yaw = wrapped(poses[..., 2] + turned.view(-1, *extra) * torch.pi)
        return torch.cat([xy, yaw[..., None]], -1)

    moved = replace(
        labels,
        pick_pose=flat(labels.pick_pose),
        place_pose=flat(labels.place_pose),
        objects=_moved_objects(labels.objects, sign, offset, turned),
        bases=_swapped(flat(labels.bases), swapped),
        gap_m=(labels.gap_m * sign[:, None] + offset[:, :1]).sort(1).values,
        arms=_swapped(labels.arms, swapped),
        decision=_renumbered(labels.decision, swapped, robots),
        robot_colors=[
            colors[::-1] if turn else colors
            for colors, turn in zip(labels.robot_colors, swapped.tolist(), strict=True)
        ],
    )
    return replace(
        _with_moved_maps(batch, shift, turned),
        joints=_swapped(batch.joints, swapped),
        opening_m=_swapped(batch.opening_m, swapped),
        past=_renumbered(batch.past, swapped, robots),
        labels=moved,
    )


def _with_moved_maps(batch: Batch, shift: Tensor, turned: Tensor) -> Batch:
    raster, device = batch.raster, batch.rgb.device
    shift, turned = sent(shift, device), sent(turned, device)
    rows, rows_seen = _sources(raster.rows, shift[:, 0], turned)
    columns, columns_seen = _sources(raster.columns, shift[:, 1], turned)
    seen = rows_seen[:, :, None] & columns_seen[:, None, :]
    return _copied(batch, rows[:, :, None], columns[:, None, :], seen)


def _sources(size: int, shift: Tensor, turned: Tensor) -> tuple[Tensor, Tensor]:
    """Return the source rows or columns, (B, size), and whether they exist."""
    places = torch.arange(size, device=shift.device) - shift[:, None]
    seen = (places >= 0) & (places < size)
    places = torch.where(turned[:, None], size - 1 - places, places)
    return places.clamp(0, size - 1), seen


def _moved_objects(
    objects: Tensor, sign: Tensor, offset: Tensor, turned: Tensor
) -> Tensor:
    """Return positions and quaternions (B, entities, 7) of a moved scene."""
    xy = objects[..., :2] * sign[:, None, None] + offset[:, None]
    sin = turned[:, None].float()
    spun = _spun(objects[..., 3:], 1.0 - sin, sin)
    return torch.cat([xy, objects[..., 2:3], spun], -1)


def _swapped(values: Tensor, turned: Tensor) -> Tensor:
    """Return values of robots (B, R, ...), in reverse order in turned scenes."""
    extra = (1,) * (values.ndim - 1)
    return torch.where(turned.view(-1, *extra), values.flip(1), values)


def _renumbered(decisions: Tensor, turned: Tensor, robots: int) -> Tensor:
    """Return decisions (B, ..., 4), with exchanged robots in turned scenes."""
    extra = (1,) * (decisions.ndim - 1)
    others = turned_numbers(decisions, robots)
    return torch.where(turned.view(-1, *extra), others, decisions)


def _noisy_colors(
    batch: Batch, options: Augmentation, amounts: Tensor, generator: torch.Generator
) -> Batch:
    """Change brightness, contrast and each color; ``amounts`` (B, 3) in -1 to 1."""
    brightness, contrast, noise = amounts.unbind(1)
    scale = 1.0 + options.brightness * contrast
    offset = 255.0 * options.brightness * brightness * 0.5 + 127.5 * (1.0 - scale)
    spread = 255.0 * options.pixel_noise * noise.abs()
    rgb = batch.rgb * scale.view(-1, 1, 1, 1) + offset.view(-1, 1, 1, 1)
    if options.pixel_noise:
        drawn = torch.randn(rgb.shape, generator=generator, device=rgb.device)
        rgb = rgb + drawn * spread.view(-1, 1, 1, 1)
    rgb = rgb.round().clamp(0, 255).to(torch.uint8)
    return replace(batch, rgb=rgb * batch.coverage[..., None])


def _noisy_heights(batch: Batch, amount: Tensor, generator: torch.Generator) -> Batch:
    """Change each height; ``amount`` (B,) is the standard deviation [m]."""
    height = batch.height_m
    drawn = torch.randn(height.shape, generator=generator, device=height.device)
    noisy = height + drawn * amount.view(-1, 1, 1)
    return replace(batch, height_m=torch.where(batch.coverage, noisy, 0.0))


def _with_holes(batch: Batch, most: int, rng: np.random.Generator) -> Batch:
    """Remove up to ``most`` small rectangles from each frame's images."""
    count, (height, width) = len(batch), batch.coverage.shape[1:]
    sides = rng.integers(HOLE_CELLS[0], HOLE_CELLS[1] + 1, (2, count, most))
    # A hole of size 0 is no hole.
    sides *= np.arange(most) < rng.integers(0, most + 1, (count, 1))
    starts = rng.integers(0, [[[height]], [[width]]], (2, count, most))
    device = batch.rgb.device

    inside = []
    for size, start, side in zip((height, width), starts, sides, strict=True):
        past = np.arange(size) - start[..., None]
        inside.append((past >= 0) & (past < side[..., None]))
    rows, columns = (sent(torch.from_numpy(one), device).float() for one in inside)
    kept = batch.coverage & (rows.transpose(1, 2) @ columns == 0)
    return replace(
        batch,
        rgb=batch.rgb * kept[..., None],
        height_m=batch.height_m * kept,
        coverage=kept,
    )
