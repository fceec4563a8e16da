"""Positions and yaws on feature maps, rotated crops, and correlation with kernels.

Every cell of a feature map covers ``stride`` x ``stride`` cells of the raster. A
position is a cell and an offset in it; a yaw, counter-clockwise seen from above, is a
bin and a residual. Rows increase towards -y, columns towards +x; the columns of a crop
about a pose are along the pose's x axis.
"""

import math
from dataclasses import dataclass

import torch
from scipy.fft import next_fast_len
from torch import Tensor
from torch.nn import functional as F

from lemma.scene.raster import Raster


@dataclass(frozen=True, slots=True)
class Cells:
    """The cells of a feature map, numbered row by row."""

    rows: int
    columns: int
    cell_m: float
    """Side of a cell [m]."""

    @classmethod
    def of(cls, raster: Raster, stride: int) -> "Cells":
        """Return the cells of a feature map; the stride must divide the raster."""
        return cls(
            raster.rows // stride, raster.columns // stride, raster.cell_m * stride
        )

    def __len__(self) -> int:
        """Return the number of cells."""
        return self.rows * self.columns

    def holding(self, xy_m: Tensor) -> Tensor:
        """Return the numbers of the cells at positions, or nearest to them.

        Args:
            xy_m: World frame [m], (..., 2).
        """
        column, row = self.continuous(xy_m).floor().long().unbind(-1)
        return row.clamp(0, self.rows - 1) * self.columns + column.clamp(
            0, self.columns - 1
        )

    def continuous(self, xy_m: Tensor) -> Tensor:
        """Return fractional columns and rows, (..., 2), also outside of the map."""
        x, y = xy_m.unbind(-1)
        column = x / self.cell_m + self.columns / 2
        return torch.stack([column, self.rows / 2 - y / self.cell_m], -1)

    def centres(self, numbers: Tensor) -> Tensor:
        """Return the centres of cells in the world frame [m], (..., 2)."""
        column, row = numbers % self.columns, numbers // self.columns
        x = (column + 0.5 - self.columns / 2) * self.cell_m
        y = (self.rows / 2 - row - 0.5) * self.cell_m
        return torch.stack([x, y], -1)

    def around(self, numbers: Tensor) -> Tensor:
        """Return the 3 x 3 cells around each cell, clipped to the map.

        Args:
            numbers: Cells, (B,).

        Returns:
            Cells, (B, 9); the cell itself is at index 4.
        """
        step = torch.arange(-1, 2, device=numbers.device)
        row = (numbers // self.columns)[:, None] + step
        column = (numbers % self.columns)[:, None] + step
        row, column = row.clamp(0, self.rows - 1), column.clamp(0, self.columns - 1)
        return (row[:, :, None] * self.columns + column[:, None, :]).flatten(1)

    def offsets(self, xy_m: Tensor, numbers: Tensor) -> Tensor:
        """Return offsets of positions from cells, (..., 2), in sides of a cell.

        Args:
            xy_m: World frame [m], (..., 2).
            numbers: Cells, (...).
        """
        return (xy_m - self.centres(numbers)) / self.cell_m

    def positions(self, numbers: Tensor, offsets: Tensor) -> Tensor:
        """Return world positions [m], (..., 2): the inverse of :meth:`offsets`."""
        return self.centres(numbers) + offsets * self.cell_m


def read_at(features: Tensor, numbers: Tensor) -> Tensor:
    """Return the features of cells.

    Args:
        features: (B, C, rows, columns).
        numbers: Cells, (B, K).

    Returns:
        (B, K, C).
    """
    flat = features.flatten(2)
    index = numbers[:, None, :].expand(-1, flat.shape[1], -1)
    return flat.gather(2, index).transpose(1, 2)


def read_finer(features: Tensor, numbers: Tensor, columns: int, finer: int) -> Tensor:
    """Return the features of finer cells, and which part of a coarse cell each is.

    Args:
        features: (B, C, rows, columns) of coarse cells.
        numbers: Fine cells, (B, K).
        columns: Number of columns of fine cells.
        finer: Fine cells along a side of a coarse one.

    Returns:
        (B, K, C + finer**2).
    """
    row, column = numbers // columns, numbers % columns
    coarse = (row // finer) * features.shape[-1] + column // finer
    part = (row % finer) * finer + column % finer
    found = read_at(features, coarse)
    return torch.cat([found, F.one_hot(part, finer**2).to(found.dtype)], -1)


def wrapped(angle: Tensor) -> Tensor:
    """Return angles [rad] in [-pi, pi)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def seen_from(pose: Tensor, xy_m: Tensor) -> Tensor:
    """Return world positions in the frames of poses [m], (B, 2)."""
    x, y = (xy_m - pose[:, :2]).unbind(1)
    cos, sin = pose[:, 2].cos(), pose[:, 2].sin()
    return torch.stack([cos * x + sin * y, cos * y - sin * x], 1)


def bin_yaws(bins: int, device: torch.device | None = None) -> Tensor:
    """Return the central yaws of bins of a full turn [rad], (bins,)."""
    return torch.arange(bins, device=device) * (2 * math.pi / bins)


def nearest_bins(yaw: Tensor, bins: int) -> tuple[Tensor, Tensor]:
    """Return the two nearest bins of yaws, with residuals.

    Args:
        yaw: [rad], (...).
        bins: Number of bins of a full turn.

    Returns:
        Bins, nearest first, (..., 2) int64, and the residuals of the yaw from them, in
        widths of a bin, (..., 2), in [-1, 1].
    """
    width = 2 * math.pi / bins
    position = torch.remainder(yaw, 2 * math.pi) / width
    nearest = position.round()
    rest = position - nearest
    side = torch.where(rest < 0, -1.0, 1.0)
    both = torch.stack([nearest, nearest + side], -1)
    return torch.remainder(both, bins).long(), torch.stack([rest, rest - side], -1)


def yaw_of(bin_number: Tensor, residual: Tensor, bins: int) -> Tensor:
    """Return the yaw [rad] of a bin and a residual; see :func:`nearest_bins`."""
    return wrapped((bin_number + residual) * (2 * math.pi / bins))


def pose_in(
    cells: Cells, numbers: Tensor, offsets: Tensor, yaws: Tensor, residuals: Tensor
) -> Tensor:
    """Return the pose in one cell per image: x, y [m] and yaw [rad], (B, 3).

    Args:
        cells: The cells.
        numbers: Numbers of the cells, (B, 1).
        offsets: Offsets in them, (B, 1, 2).
        yaws: Logits of the bins of yaw, (B, 1, bins).
        residuals: Residual of each bin in widths of a bin, (B, 1, bins).
    """
    best = yaws.argmax(-1, keepdim=True)
    yaw = yaw_of(best, residuals.gather(-1, best), yaws.shape[-1])
    return torch.cat([cells.positions(numbers, offsets), yaw], -1)[:, 0]


def crop_about(
    image: Tensor, pose: Tensor, raster: Raster, size: int, side_m: float
) -> Tensor:
    """Cut squares out of maps, centered at poses and rotated with them.

    Args:
        image: (B, C, rows, columns), on the cells of the raster.
        pose: x, y [m], yaw [rad] of the center of the square, (B, 3).
        raster: Raster of the maps.
        size: Cells along a side of the square.
        side_m: Length of its side [m].

    Returns:
        (B, C, size, size); 0 outside of the map.
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
    """Rotate square feature maps by several angles about their centers.

    Args:
        features: (B, C, n, n).
        yaws: [rad], counter-clockwise, (R,).
        scale: Ratio of the size of their cells to that of the result's cells.

    Returns:
        (B, R, C, s, s) with s odd, n * scale or the next odd number, so that a cell is
        in the center.
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


def correlate(key: Tensor, kernels: Tensor) -> Tensor:
    """Correlate each sample's map with each of its kernels, by FFT.

    The kernels cover a metre of the table, so a direct convolution would be far slower.

    Args:
        key: (B, C, rows, columns).
        kernels: (B, R, C, s, s) with s odd.

    Returns:
        Correlation with the kernel's center on each cell, (B, R, rows, columns)
        float32; the map is zero-padded.
    """
    rows, columns = key.shape[-2:]
    half = kernels.shape[-1] // 2
    # Pad so that the wrap-around stays in the padding.
    size = tuple(next_fast_len(n + half, real=True) for n in (rows, columns))
    with torch.autocast(key.device.type, enabled=False):
        key_spectrum = torch.fft.rfft2(key.float(), s=size)
        kernel_spectra = torch.fft.rfft2(kernels.float(), s=size)
        product = (key_spectrum[:, None] * kernel_spectra.conj()).sum(2)
        fits = torch.fft.irfft2(product, s=size)
    return torch.roll(fits, (half, half), (-2, -1))[..., :rows, :columns]
