"""Marks of ReachNet's perception: where on the map entities and robots may be."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lemma.scene.raster import Raster

STRIDE = 4
"""Cells of the map along each side of an output cell."""
_CANDIDATES = 16
"""Number of likely cells of each point of the stick."""
_ERROR_M = 0.005
"""Error of the distance of predicted points of the stick [m]."""


@dataclass(frozen=True, eq=False)
class Marks:
    """Output of the U-Net for B maps of H x W cells, with R robots and N points.

    The points are the entities and one ahead on the stick.
    """

    points: Tensor
    """Log-probability of each cell, the last one for "not present",
    (B, N + R, H * W + 1)."""
    offsets: Tensor
    """Offsets in the cell, in sides of a cell, (B, N + R, 2, H * W)."""
    yaw: Tensor
    """Cosine and sine of the yaw times each order of symmetry, (B, folds, 2, H * W)."""
    features: Tensor
    """(B, channels, H * W)."""
    shape: tuple[int, int]
    """H and W."""


def read_points(marks: Marks, stick: int, length_m: float, raster: Raster) -> Tensor:
    """Return the most likely positions of all points, (B, N + R, 2) [m].

    Args:
        marks: Marks of maps.
        stick: Number of the stick, the last entity; after it comes the point ahead.
        length_m: Distance of both [m].
        raster: Raster of the maps.
    """
    cell = marks.points[..., :-1].argmax(2, keepdim=True)
    points = _positions(cell, marks.offsets, raster).squeeze(2)
    points[:, stick : stick + 2] = _stick_points(marks, stick, length_m, raster)
    return points


def _positions(cell: Tensor, offsets: Tensor, raster: Raster) -> Tensor:
    """Return the positions that cells predict for points, (B, N, K, 2) [m].

    Args:
        cell: K cells for each of N points, (B, N, K).
        offsets: Offsets of all cells, (B, N, 2, H * W).
        raster: Raster of the maps.
    """
    size = raster.cell_m * STRIDE
    columns, rows = raster.columns // STRIDE, raster.rows // STRIDE
    index = cell[:, :, None].expand(-1, -1, 2, -1)
    offset = offsets.gather(3, index).clamp(-2.0, 2.0).transpose(2, 3)
    place = torch.stack([cell % columns, cell // columns], -1) + 0.5 + offset
    x = (place[..., 0] - columns / 2) * size
    y = (rows / 2 - place[..., 1]) * size
    return torch.stack([x, y], -1)


def _stick_points(marks: Marks, stick: int, length_m: float, raster: Raster) -> Tensor:
    """Return the likeliest origin of sticks and point ahead, (B, 2, 2) [m].

    Their distance is known. Each point alone would be wrong where an arm hides it.
    """
    both = slice(stick, stick + 2)
    likely, cells = marks.points[:, both, :-1].topk(_CANDIDATES, 2)
    points = _positions(cells, marks.offsets[:, both], raster)
    origin, ahead = points[:, 0, :, None], points[:, 1, None]
    off = ((ahead - origin).norm(dim=-1) - length_m) / _ERROR_M
    scores = likely[:, 0, :, None] + likely[:, 1, None] - 0.5 * off.square()
    best = scores.flatten(1).argmax(1)
    rows = torch.arange(len(best), device=best.device)
    first, second = best // _CANDIDATES, best % _CANDIDATES
    return torch.stack([points[rows, 0, first], points[rows, 1, second]], 1)
