"""The top-down map: all cameras fused into one orthographic image of the table.

Every pixel of every camera is unprojected to a point in the world. The highest point in
each cell of the map determines the height and color of the cell.

The loops are compiled by Numba: the same images give the same map on every machine, and
a map of two 640 x 480 images takes a few milliseconds.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.scene.cameras import Camera, CameraImage
from lemma.scene.raster import CEILING_M, RASTER, MapImage, Raster


def fuse(
    images: Iterable[CameraImage], raster: Raster = RASTER, ceiling_m: float = CEILING_M
) -> MapImage:
    """Fuse calibrated images into a map.

    Among points of equal height, the first image has priority, and within an image the
    point nearest to its top left corner.

    At large distances or flat angles a camera's samples are more than a cell apart. A
    cell without a sample gets the lower of two samples on opposite sides. This closes
    gaps in surfaces without extending objects.

    Args:
        images: Images of the cameras; a depth of 0 means no surface.
        raster: The cells of the map.
        ceiling_m: Height above which points are ignored [m].

    Raises:
        InvalidConfigError: An image does not have its camera's size, or the ceiling is
            not above the floor.
    """
    if not raster.floor_m < ceiling_m:
        raise InvalidConfigError(
            f"No height lies between floor_m={raster.floor_m} and "
            f"ceiling_m={ceiling_m}. The floor must be lower."
        )
    height = np.full((raster.rows, raster.columns), -np.inf, np.float32)
    rgb = np.zeros((raster.rows, raster.columns, 3), np.uint8)
    for color, depth, camera in images:
        lens = camera.intrinsics
        shape = (lens.height, lens.width)
        if color.shape != (*shape, 3) or depth.shape != shape:
            raise InvalidConfigError(
                f"The images of camera {camera.name!r} have shapes {color.shape} "
                f"and {depth.shape}. Valid: {(*shape, 3)} and {shape}."
            )
        splat(
            np.ascontiguousarray(color),
            np.ascontiguousarray(depth, dtype=np.float32),
            _cells_from_image(camera, raster),
            (raster.floor_m, ceiling_m),
            height,
            rgb,
        )
    filled = height.copy()
    coverage = close_gaps(height, filled, rgb)
    return MapImage(rgb, filled, coverage)


def _cells_from_image(camera: Camera, raster: Raster) -> FloatArray:
    """Return the matrix from (u z, v z, z, 1) to (column, row, height), (3, 4)."""
    lens = camera.intrinsics
    pose = camera.world_from_camera.matrix()
    result = np.empty((3, 4))
    scale = (1.0 / raster.cell_m, -1.0 / raster.cell_m, 1.0)
    shift = (raster.columns / 2, raster.rows / 2, 0.0)
    for i in range(3):
        a, b = float(pose[i, 0]) / lens.fx, float(pose[i, 1]) / lens.fy
        c = float(pose[i, 2]) - a * lens.cx - b * lens.cy
        for j, value in enumerate((a, b, c, float(pose[i, 3]))):
            result[i, j] = value * scale[i]
        result[i, 3] += shift[i]
    return result


@kernel(nogil=True)
def splat(
    color: NDArray[np.uint8],
    depth: NDArray[np.float32],
    cells_from_image: FloatArray,
    limits_m: tuple[float, float],
    height: NDArray[np.float32],
    rgb: NDArray[np.uint8],
) -> None:
    """Add the points of one image to a map, in place.

    Args:
        color: Color, shape (H, W, 3).
        depth: Depth [m], shape (H, W); 0 where there is no surface.
        cells_from_image: Matrix from (u z, v z, z, 1) to (column, row, height), shape
            (3, 4).
        limits_m: Smallest and largest height of points to add [m].
        height: Heights of the map [m], shape (rows, columns); minus infinity if empty.
        rgb: Colors of the map, shape (rows, columns, 3).
    """
    m = cells_from_image
    rows, columns = height.shape
    lowest, highest = limits_m
    for v in range(depth.shape[0]):
        c0 = m[0, 1] * v + m[0, 2]
        c1 = m[1, 1] * v + m[1, 2]
        c2 = m[2, 1] * v + m[2, 2]
        for u in range(depth.shape[1]):
            z = np.float64(depth[v, u])
            if not z > 0.0:
                continue
            top = np.float32((m[2, 0] * u + c2) * z + m[2, 3])
            if not lowest <= top <= highest:
                continue
            x = (m[0, 0] * u + c0) * z + m[0, 3]
            y = (m[1, 0] * u + c1) * z + m[1, 3]
            if not (0.0 <= x < columns and 0.0 <= y < rows):
                continue
            row, column = int(y), int(x)
            if top > height[row, column]:
                height[row, column] = top
                for k in range(3):
                    rgb[row, column, k] = color[v, u, k]


@kernel(nogil=True)
def close_gaps(
    height: NDArray[np.float32], filled: NDArray[np.float32], rgb: NDArray[np.uint8]
) -> NDArray[np.bool_]:
    """Fill cells between two samples, in place, and return the coverage.

    Args:
        height: Heights of the map [m], shape (rows, columns); minus infinity if empty.
        filled: A copy of the heights; written, 0 in cells that remain empty.
        rgb: Colors of the map, shape (rows, columns, 3); written.

    Returns:
        Whether each cell has a sample or is filled, shape (rows, columns).
    """
    rows, columns = height.shape
    coverage = np.ones((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            if height[row, column] > -np.inf:
                continue
            best_row, best_column, best = -1, -1, np.float32(np.inf)
            for a, b in ((0, 1), (1, 0), (1, 1), (1, -1)):
                r0, r1, c0, c1 = row - a, row + a, column - b, column + b
                if r0 < 0 or r1 >= rows or min(c0, c1) < 0 or max(c0, c1) >= columns:
                    continue
                first, second = height[r0, c0], height[r1, c1]
                lower = min(first, second)
                if lower > -np.inf and lower < best:
                    best = lower
                    best_row, best_column = (r0, c0) if first <= second else (r1, c1)
            if best_row < 0:
                coverage[row, column] = False
                filled[row, column] = 0.0
            else:
                filled[row, column] = best
                for k in range(3):
                    rgb[row, column, k] = rgb[best_row, best_column, k]
    return coverage
