"""The raster of a top-down map, and how depths and heights are rounded.

A map is an orthographic picture of the table. Row 0 lies at +y and column 0 at -x:
seen in the usual way, x grows to the right and y upward.

All views have depths and heights in steps of 0.1 mm, because files of rendered
keyframes store them as ``uint16`` in these units: a policy that was trained on files
then sees the same numbers everywhere. No depth camera is that accurate, and a pixel of
these sees some millimetres; a millimetre would show as steps in slanted surfaces, and
finer units would not fit the room into 16 bits. 0 means that nothing was seen.

Plain data: nothing here needs MuJoCo.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lemma.core.errors import InvalidConfigError

UNIT_M = 1e-4
"""Unit of stored depths and heights [m]."""
CEILING_M = 0.6
"""Points above it are not on the map: the table below them counts as not seen [m]."""

LARGEST = 65535
"""The largest number that is stored."""


@dataclass(frozen=True, slots=True)
class Raster:
    """Where the cells of a top-down map are, centered on the origin of the world."""

    rows: int = 416
    """Cells along y; row 0 lies at +y."""
    columns: int = 416
    """Cells along x; column 0 lies at -x."""
    cell_m: float = 0.008
    """Side of a cell [m]."""
    floor_m: float = -0.1
    """Points below it, beside the table, are not on the map. A stored
    height of 1 means this height [m]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.rows < 1 or self.columns < 1 or not self.cell_m > 0:
            raise InvalidConfigError(
                f"A map of {self.rows} x {self.columns} cells of {self.cell_m} m has "
                "no area. All three must be positive."
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent along x and along y [m]."""
        return (self.columns * self.cell_m, self.rows * self.cell_m)

    def pixel_from_world(self, x: float, y: float) -> tuple[int, int]:
        """Return row and column of the cell that holds a point of the table.

        Args:
            x: Position [m], world frame.
            y: Position [m], world frame.

        Returns:
            The cell; beyond the first or last one if the point lies outside the map.
        """
        row = math.floor(self.rows / 2 - y / self.cell_m)
        return row, math.floor(self.columns / 2 + x / self.cell_m)

    def world_from_pixel(self, row: float, column: float) -> tuple[float, float]:
        """Return the position (x, y) of a cell's center [m], world frame.

        Args:
            row: Row; fractions are allowed.
            column: Column; fractions are allowed.
        """
        x = (column + 0.5 - self.columns / 2) * self.cell_m
        return x, (self.rows / 2 - row - 0.5) * self.cell_m

    def encode_height(
        self, height_m: ArrayLike, coverage: NDArray[np.bool_]
    ) -> NDArray[np.uint16]:
        """Return heights [m] as they are stored; 0 where nothing was seen."""
        above = np.asarray(height_m, np.float64) - self.floor_m
        values = np.rint(above / UNIT_M) + 1.0
        return np.where(coverage, values, 0.0).astype(np.uint16)

    def decode_height(self, values: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Return stored heights above the table [m]; 0 where nothing was seen."""
        height_m = values * np.float32(UNIT_M) + np.float32(self.floor_m - UNIT_M)
        height_m[values == 0] = 0.0
        return height_m


RASTER = Raster()
"""The raster of every map that policies see."""


@dataclass(frozen=True, slots=True)
class MapImage:
    """A fused view from above."""

    rgb: NDArray[np.uint8]
    """Color of the highest point, shape (rows, columns, 3); black where not seen."""
    height_m: NDArray[np.float32]
    """Height of the highest point above the table [m]; 0 where not seen."""
    coverage: NDArray[np.bool_]
    """Whether a camera sees the cell, shape (rows, columns)."""


def encode_depth(depth_m: ArrayLike) -> NDArray[np.uint16]:
    """Return depths [m] as they are stored; 0 where nothing is within 6.5 m."""
    values = np.rint(np.asarray(depth_m, np.float64) / UNIT_M)
    return np.where(values <= LARGEST, values, 0.0).astype(np.uint16)


def decode_depth(values: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return stored depths [m]; 0 where nothing was seen."""
    return values * np.float32(UNIT_M)
