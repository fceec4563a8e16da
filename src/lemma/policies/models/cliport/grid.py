"""Cells of feature maps, which are coarser than the map, and positions in the world.

Every cell of a map that a network makes covers ``stride`` x ``stride`` cells of the
raster. A position is told by the cell that holds it and by where it is in that cell.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from lemma.scene.raster import Raster


@dataclass(frozen=True, slots=True)
class Cells:
    """The cells of a feature map; numbered row by row."""

    rows: int
    columns: int
    cell_m: float
    """Side of a cell [m]."""

    @classmethod
    def of(cls, raster: Raster, stride: int) -> "Cells":
        """Return the cells of a map whose sides a stride divides."""
        return cls(
            raster.rows // stride, raster.columns // stride, raster.cell_m * stride
        )

    def __len__(self) -> int:
        """Return how many there are."""
        return self.rows * self.columns

    def holding(self, xy_m: Tensor) -> Tensor:
        """Return the numbers of the cells that hold positions, or lie next to them.

        Args:
            xy_m: World frame [m], (..., 2).
        """
        column, row = self._continuous(xy_m).floor().long().unbind(-1)
        return row.clamp(0, self.rows - 1) * self.columns + column.clamp(
            0, self.columns - 1
        )

    def centres(self, numbers: Tensor) -> Tensor:
        """Return the centres of cells in the world frame [m], (..., 2)."""
        column, row = numbers % self.columns, numbers // self.columns
        x = (column + 0.5 - self.columns / 2) * self.cell_m
        y = (self.rows / 2 - row - 0.5) * self.cell_m
        return torch.stack([x, y], -1)

    def around(self, numbers: Tensor) -> Tensor:
        """Return the nine cells around and including each, clipped to the map.

        Args:
            numbers: Cells, (B,).

        Returns:
            Cells, (B, 9); number 4 is the one in the middle.
        """
        step = torch.arange(-1, 2, device=numbers.device)
        row = (numbers // self.columns)[:, None] + step
        column = (numbers % self.columns)[:, None] + step
        row, column = row.clamp(0, self.rows - 1), column.clamp(0, self.columns - 1)
        return (row[:, :, None] * self.columns + column[:, None, :]).flatten(1)

    def offsets(self, xy_m: Tensor, numbers: Tensor) -> Tensor:
        """Return where positions are, seen from cells, in sides of a cell.

        Args:
            xy_m: World frame [m], (..., 2).
            numbers: Cells, (...).
        """
        return (xy_m - self.centres(numbers)) / self.cell_m

    def positions(self, numbers: Tensor, offsets: Tensor) -> Tensor:
        """Return the positions [m] that :meth:`offsets` would describe so."""
        return self.centres(numbers) + offsets * self.cell_m

    def _continuous(self, xy_m: Tensor) -> Tensor:
        x, y = xy_m.unbind(-1)
        column = x / self.cell_m + self.columns / 2
        return torch.stack([column, self.rows / 2 - y / self.cell_m], -1)


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
