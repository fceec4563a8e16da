"""Sectors: the cells of a grid over the table that an arm sweeps."""

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M

Cells = npt.NDArray[np.bool_]
"""A set of cells of the grid over the table, (n,)."""

MARGIN_M = 0.17
"""Margin on each side of the line from base to gripper. With 0.10 m two of twenty pairs
of arms touched, because elbow and wrist are beside that line."""

_CELL_M = 0.05
_ACROSS, _DEEP = (
    2 * round(half_m / _CELL_M) for half_m in (TABLE_HALF_X_M, TABLE_HALF_Y_M)
)
CELLS = _ACROSS * _DEEP


def cell_at(x: float, y: float) -> int | None:
    """Return the index of the cell at a position [m]; None outside the table."""
    column = math.floor(x / _CELL_M) + _ACROSS // 2
    row = math.floor(y / _CELL_M) + _DEEP // 2
    inside = 0 <= column < _ACROSS and 0 <= row < _DEEP
    return row * _ACROSS + column if inside else None


@kernel
def clip(  # noqa: PLR0913 - one call is what makes it fast
    polar: FloatArray,
    x: float,
    y: float,
    tcp: FloatArray,
    joint: float,
    stops: FloatArray,
    beyond_m: float,
    out: Cells,
) -> None:
    """Remove from ``out`` the cells that an arm does not sweep on its way.

    Args:
        polar: Polar coordinates of the cells, see :func:`polar_of`.
        x: World x of the base [m].
        y: World y of the base [m].
        tcp: World from gripper at the tool centre point, (4, 4) [m].
        joint: Present angle of the base joint [rad].
        stops: World x, y of the gripper [m] and base joint angle [rad], (k, 3).
        beyond_m: Margin beyond the gripper [m].
        out: The arm's cells, (n,); written.
    """
    farthest = math.hypot(tcp[0, 3] - x, tcp[1, 3] - y)
    for i in range(stops.shape[0]):
        farthest = max(farthest, math.hypot(stops[i, 0] - x, stops[i, 1] - y))
    swept = np.zeros(out.shape[0], np.bool_)
    at = math.atan2(tcp[1, 3] - y, tcp[0, 3] - x)
    for i in range(stops.shape[0]):
        # Bearing and base joint differ, because the gripper is beside the arm's plane.
        # The bearings give the size of the turn, and the joint its number of turns.
        bearing = math.atan2(stops[i, 1] - y, stops[i, 0] - x)
        turn = bearing - at
        turn += math.tau * round((stops[i, 2] - joint - turn) / math.tau)
        _sweep(polar, at, turn, farthest + beyond_m, swept)
        at, joint = bearing, stops[i, 2]
    for i in range(out.shape[0]):
        out[i] = out[i] and swept[i]


@kernel
def _sweep(
    polar: FloatArray, at: float, turn: float, farthest: float, out: Cells
) -> None:
    """Add to ``out`` the cells that an arm sweeps as it turns from a bearing.

    Args:
        polar: Polar coordinates of the cells, see :func:`polar_of`.
        at: Bearing of the gripper at the start [rad].
        turn: Angle of the turn, positive to the left [rad].
        farthest: Radius of the swept sector [m].
        out: Written, (n,).
    """
    for i in range(out.shape[0]):
        if out[i] or polar[0, i] > farthest:
            continue
        ahead = polar[1, i] - at if turn >= 0.0 else at - polar[1, i]
        while ahead < 0.0:
            ahead += math.tau
        while ahead >= math.tau:
            ahead -= math.tau
        slack = polar[2, i]
        out[i] = ahead <= abs(turn) + slack or ahead >= math.tau - slack


@lru_cache(maxsize=32)
def polar_of(x: float, y: float) -> FloatArray:
    """Return distance [m] and bearing [rad] of each cell from a base, (3, n).

    The last row is the angle of :data:`MARGIN_M` at that distance [rad].
    """
    # Results of NumPy's functions differ between CPUs; those of ``math`` do not.
    across, deep = (
        [(i + 0.5) * _CELL_M for i in range(-count // 2, count // 2)]
        for count in (_ACROSS, _DEEP)
    )
    away = [(u - x, v - y) for v in deep for u in across]
    radius = [max(math.hypot(u, v), 1e-6) for u, v in away]
    bearing = [math.atan2(v, u) for u, v in away]
    return np.array(
        [radius, bearing, [math.asin(min(1.0, MARGIN_M / r)) for r in radius]]
    )
