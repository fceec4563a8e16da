"""Yaw as bins and residuals; crops and kernels that are turned in the plane.

Yaw is counter-clockwise seen from above. Rows of a map go down, towards -y, columns to
the right, towards +x; a crop about a pose has its columns along the pose's x axis.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.scene.raster import Raster


def wrapped(angle: Tensor) -> Tensor:
    """Return angles [rad] in [-pi, pi)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def bin_yaws(bins: int, device: torch.device | None = None) -> Tensor:
    """Return the yaws in the middle of bins of a whole turn [rad], (bins,)."""
    return torch.arange(bins, device=device) * (2 * math.pi / bins)


def nearest_bins(yaw: Tensor, bins: int) -> tuple[Tensor, Tensor]:
    """Return the nearest bin and the second nearest, and how far off they are.

    Args:
        yaw: [rad], (...).
        bins: Number of bins of a whole turn.

    Returns:
        Bins, (..., 2) int64, and what is to be added to them, in widths of a bin,
        (..., 2), in [-1, 1].
    """
    width = 2 * math.pi / bins
    position = torch.remainder(yaw, 2 * math.pi) / width
    nearest = position.round()
    rest = position - nearest
    side = torch.where(rest < 0, -1.0, 1.0)
    both = torch.stack([nearest, nearest + side], -1)
    return torch.remainder(both, bins).long(), torch.stack([rest, rest - side], -1)


def yaw_of(bin_number: Tensor, residual: Tensor, bins: int) -> Tensor:
    """Return the yaw [rad] that :func:`nearest_bins` would describe so."""
    return wrapped((bin_number + residual) * (2 * math.pi / bins))


def crop_about(
    image: Tensor, pose: Tensor, raster: Raster, size: int, side_m: float
) -> Tensor:
    """Cut a square out of maps, turned with a pose.

    Args:
        image: (B, C, rows, columns), on the cells of the raster.
        pose: x, y [m], yaw [rad] of the middle of the square, (B, 3).
        raster: Where the cells are.
        size: Cells along a side of the square.
        side_m: Its side [m].

    Returns:
        (B, C, size, size); 0 outside the map.
    """
    cell_m = side_m / size
    steps = (torch.arange(size, device=image.device) + 0.5 - size / 2) * cell_m
    ahead, left = steps[None, None, :], -steps[None, :, None]
    x, y, yaw = (value[:, None, None] for value in pose.unbind(1))
    cos, sin = yaw.cos(), yaw.sin()
    at_x = x + cos * ahead - sin * left
    at_y = y + sin * ahead + cos * left
    half_width = raster.columns * raster.cell_m / 2
    half_height = raster.rows * raster.cell_m / 2
    grid = torch.stack([at_x / half_width, -at_y / half_height], -1)
    return F.grid_sample(image, grid, align_corners=False)


def turned(features: Tensor, yaws: Tensor, scale: float = 1.0) -> Tensor:
    """Turn square feature maps by several angles about their middles.

    Args:
        features: (B, C, n, n).
        yaws: [rad], counter-clockwise, (R,).
        scale: How many times larger their cells are than those of the result.

    Returns:
        (B, R, C, s, s) with s odd, n * scale or the next one, so that a cell lies in
        the middle.
    """
    count, channels, size, _ = features.shape
    wide = round(size * scale)
    side = wide + 1 - wide % 2
    steps = (torch.arange(side, device=features.device) - side // 2) * (2.0 / wide)
    right, up = steps[None, None, :], -steps[None, :, None]
    cos, sin = yaws.cos()[:, None, None], yaws.sin()[:, None, None]
    ahead = cos * right + sin * up
    left = cos * up - sin * right
    grid = torch.stack([ahead, -left], -1).flatten(0, 1)
    found = F.grid_sample(features, grid.expand(count, -1, -1, -1), align_corners=False)
    return found.view(count, channels, len(yaws), side, side).transpose(1, 2)
