"""Changes of a batch after which its labels are exactly as right as before.

All frames of an episode are changed in the same way, because models see them together.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, Batch, with_sub_instructions
from lemma.policies.training.config import Augmentation
from lemma.policies.training.recolor import permute_colors

HOLE_CELLS = (2, 8)
"""Smallest and largest side of what a camera misses."""

__all__ = ["Augmentation", "augment", "move", "permute_colors"]


def augment(batch: Batch, options: Augmentation, rng: np.random.Generator) -> Batch:
    """Return a batch that is changed at random; sentences are not drawn here.

    Args:
        batch: With labels, on any device.
        options: Changes that may be drawn.
        rng: Random generator.
    """
    assert batch.labels is not None
    episodes, numbers = np.unique(batch.labels.episode.cpu(), return_inverse=True)
    count, device = len(episodes), batch.rgb.device

    def each(values: Any) -> Tensor:
        """Return values of the episodes as values of the frames."""
        return torch.from_numpy(np.asarray(values)[numbers]).to(device)

    if options.palette:
        colors = len(batch.entities.colors)
        batch = permute_colors(
            batch, each(rng.permuted(np.tile(np.arange(colors), (count, 1)), axis=1))
        )
    cells = options.translate_cells
    if options.turn or cells:
        shift = rng.integers(-cells, cells + 1, (count, 2))
        turned = rng.random(count) < 0.5 * options.turn
        batch = move(batch, each(shift), each(turned))
    generator = torch.Generator(device)
    generator.manual_seed(int(rng.integers(2**62)))
    if options.brightness or options.pixel_noise:
        amounts = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
        batch = _noisy_colors(batch, options, each(amounts), generator)
    if options.height_noise_m:
        amount = rng.uniform(0.0, options.height_noise_m, count).astype(np.float32)
        batch = _noisy_heights(batch, each(amount), generator)
    if options.dropouts:
        batch = _with_holes(batch, options.dropouts, rng)
    return with_sub_instructions(batch)


def move(batch: Batch, shift: Tensor, turned: Tensor) -> Batch:
    """Return a batch in which whole scenes are turned by half a turn, then shifted.

    Where a scene is turned the robots change numbers, because the first one is at -x.
    Cells that enter at the border count as not seen.

    Args:
        batch: With labels.
        shift: Cells by which rows and columns grow, (B, 2) int64.
        turned: Which frames are turned, (B,) bool.
    """
    labels, raster = batch.labels, batch.raster
    assert labels is not None
    rows, rows_seen = _sources(raster.rows, shift[:, 0], turned)
    columns, columns_seen = _sources(raster.columns, shift[:, 1], turned)
    frames = torch.arange(len(batch), device=rows.device)[:, None, None]
    cells = (frames, rows[:, :, None], columns[:, None, :])
    seen = rows_seen[:, :, None] & columns_seen[:, None, :]
    sign = torch.where(turned, -1.0, 1.0)
    # Rows grow against y.
    offset = torch.stack([shift[:, 1], -shift[:, 0]], 1) * raster.cell_m

    def flat(poses: Tensor) -> Tensor:
        """Return poses (B, ..., 3) in the plane."""
        extra = (1,) * (poses.ndim - 2)
        xy = poses[..., :2] * sign.view(-1, *extra, 1) + offset.view(-1, *extra, 2)
        yaw = _wrapped(poses[..., 2] + turned.view(-1, *extra) * torch.pi)
        return torch.cat([xy, yaw[..., None]], -1)

    moved = replace(
        labels,
        pick_pose=flat(labels.pick_pose),
        place_pose=flat(labels.place_pose),
        objects=_moved_objects(labels.objects, sign, offset, turned),
        bases=_swapped(flat(labels.bases), turned),
        gap_m=(labels.gap_m * sign[:, None] + offset[:, :1]).sort(1).values,
        arms=_swapped(labels.arms, turned),
        decision=_renumbered(labels.decision, turned, labels.bases.shape[1]),
        robot_colors=[
            colors[::-1] if turn else colors
            for colors, turn in zip(labels.robot_colors, turned.tolist(), strict=True)
        ],
    )
    return replace(
        batch,
        rgb=batch.rgb[cells] * seen[..., None],
        height_m=batch.height_m[cells] * seen,
        coverage=batch.coverage[cells] & seen,
        joints=_swapped(batch.joints, turned),
        opening_m=_swapped(batch.opening_m, turned),
        past=_renumbered(batch.past, turned, labels.bases.shape[1]),
        labels=moved,
    )


def _sources(size: int, shift: Tensor, turned: Tensor) -> tuple[Tensor, Tensor]:
    """Return where rows or columns come from, (B, size), and whether they exist."""
    places = torch.arange(size, device=shift.device) - shift[:, None]
    seen = (places >= 0) & (places < size)
    places = torch.where(turned[:, None], size - 1 - places, places)
    return places.clamp(0, size - 1), seen


def _moved_objects(
    objects: Tensor, sign: Tensor, offset: Tensor, turned: Tensor
) -> Tensor:
    """Return positions and quaternions (B, entities, 7) of a moved scene."""
    xy = objects[..., :2] * sign[:, None, None] + offset[:, None]
    w, x, y, z = objects[..., 3:].unbind(-1)
    # Half a turn about z, (0, 0, 0, 1), times the quaternion.
    after = torch.stack([-z, -y, x, w], -1)
    quaternion = torch.where(turned[:, None, None], after, objects[..., 3:])
    return torch.cat([xy, objects[..., 2:3], quaternion], -1)


def _swapped(values: Tensor, turned: Tensor) -> Tensor:
    """Return values of robots (B, R, ...), the other way round where it is turned."""
    extra = (1,) * (values.ndim - 1)
    return torch.where(turned.view(-1, *extra), values.flip(1), values)


def _renumbered(decisions: Tensor, turned: Tensor, robots: int) -> Tensor:
    """Return decisions (B, ..., 4) whose robots have changed numbers."""
    robot = decisions[..., 0]
    swap = turned.view(-1, *(1,) * (robot.ndim - 1)) & (robot != NOBODY)
    robot = torch.where(swap, robots - 1 - robot, robot)
    return torch.cat([robot[..., None], decisions[..., 1:]], -1)


def _wrapped(angle: Tensor) -> Tensor:
    """Return angles of at most half a turn."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


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
    """Let the cameras miss up to so many small rectangles in each frame."""
    count, (height, width) = len(batch), batch.coverage.shape[1:]
    sides = rng.integers(HOLE_CELLS[0], HOLE_CELLS[1] + 1, (2, count, most))
    # Frames have fewer holes by having some of no size.
    sides *= np.arange(most) < rng.integers(0, most + 1, (count, 1))
    starts = rng.integers(0, [[[height]], [[width]]], (2, count, most))
    device = batch.rgb.device

    def inside(size: int, axis: int) -> Tensor:
        start = torch.from_numpy(starts[axis]).to(device)[..., None]
        side = torch.from_numpy(sides[axis]).to(device)[..., None]
        places = torch.arange(size, device=device)
        return ((places >= start) & (places < start + side)).float()

    rows, columns = inside(height, 0), inside(width, 1)
    kept = batch.coverage & (rows.transpose(1, 2) @ columns == 0)
    return replace(
        batch,
        rgb=batch.rgb * kept[..., None],
        height_m=batch.height_m * kept,
        coverage=kept,
    )
