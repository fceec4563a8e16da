"""The raster of a top-down map, and the rounding of depths and heights.

A map is an orthographic image of the table. Row 0 is at +y and column 0 at -x: in the
usual orientation, x grows to the right and y upward.

All views have depths and heights in steps of 0.1 mm, because files of rendered
keyframes store them as ``uint16`` in this unit: so files and environments give policies
the same values. The unit is finer than the accuracy of depth cameras. Steps of 1 mm
would be visible on slanted surfaces, and 16 bits of a finer unit would not cover the
room. 0 means no surface.

This module does not need MuJoCo.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lemma.core.errors import InvalidConfigError

UNIT_M = 1e-4
"""Unit of stored depths and heights [m]."""
CEILING_M = 0.6
"""Height above which points are not on the map; the cells below are not covered [m]."""

LARGEST = 65535
"""Largest stored value."""


@dataclass(frozen=True, slots=True)
class Raster:
    """The cells of a top-down map, centered on the origin of the world.

    Raises:
        InvalidConfigError: A size is not positive.
    """

    rows: int = 416
    """Cells along y; row 0 lies at +y."""
    columns: int = 416
    """Cells along x; column 0 lies at -x."""
    cell_m: float = 0.008
    """Side of a cell [m]."""
    floor_m: float = -0.1
    """Height below which points, beside the table, are not on the map. A stored value
    of 1 is this height [m]."""

    def __post_init__(self) -> None:
        """Check the sizes."""
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
        """Return row and column of the cell that contains a point of the table.

        Args:
            x: World x [m].
            y: World y [m].

        Returns:
            The cell; beyond the first or last one if the point is outside the map.
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
        """Return heights as stored values, of the same shape.

        Args:
            height_m: Heights above the table [m].
            coverage: Whether each cell is covered; the others get 0.
        """
        above = np.asarray(height_m, np.float64) - self.floor_m
        values = np.rint(above / UNIT_M) + 1.0
        return np.where(coverage, values, 0.0).astype(np.uint16)

    def decode_height(self, values: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Return heights above the table [m]; 0 for cells without coverage."""
        height_m = values * np.float32(UNIT_M) + np.float32(self.floor_m - UNIT_M)
        height_m[values == 0] = 0.0
        return height_m


RASTER = Raster()
"""The raster of the maps in observations."""


@dataclass(frozen=True, slots=True)
class MapImage:
    """A top-down map."""

    rgb: NDArray[np.uint8]
    """Color of the highest point, shape (rows, columns, 3); black without coverage."""
    height_m: NDArray[np.float32]
    """Height of the highest point above the table [m], shape (rows, columns); 0 without
    coverage."""
    coverage: NDArray[np.bool_]
    """Whether a camera sees the cell, shape (rows, columns)."""


def encode_depth(depth_m: ArrayLike) -> NDArray[np.uint16]:
    """Return depths [m] as stored values; 0 where no surface is within 6.5 m."""
    values = np.rint(np.asarray(depth_m, np.float64) / UNIT_M)
    return np.where(values <= LARGEST, values, 0.0).astype(np.uint16)


def decode_depth(values: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return stored depths in metres; 0 where there is no surface."""
    return values * np.float32(UNIT_M)
