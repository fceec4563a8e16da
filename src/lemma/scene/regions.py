"""Regions: parts of the table that several robots reach, derived from their bases.

A region is a place for sub-tasks: one robot puts an object down there, and another one
picks it up. The region that the whole team reaches is called ``"shared"``. If there is
none, each pair of robots with common reach has a region: ``"shared_01"`` is that of
``robot_0`` and ``robot_1``.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from itertools import combinations
from types import MappingProxyType

from lemma.core.poses import Pose2
from lemma.robots.reach import reach_of
from lemma.scene.objects.entity import SHARED, pair_regions
from lemma.scene.table import TABLE_HALF_Y_M, Gap, lies_on_table

EDGE_M = 0.05
"""Smallest distance from the table's edge at which objects are put down [m]."""

_GRID_M = 0.02
_MARGIN_M = 0.03
_GOOD_MARGIN_M = 0.10

Stand = tuple[str, Pose2]
"""Arm type and base of a robot."""
Spot = tuple[float, float, float]
"""World x and y, and the smallest reach margin of any robot there, capped [m]."""


@lru_cache(maxsize=64)
def regions_of(
    stands: tuple[Stand, ...], gap_m: Gap | None
) -> Mapping[str, tuple[int, ...]]:
    """Return the regions of a team.

    Args:
        stands: The robots.
        gap_m: The gap in the table; None without one.

    Returns:
        The robots of each region, as indices in the team: ``{"shared": (0, 1, ...)}``
        for one or two robots, and for larger teams with common reach. Otherwise one
        region for each pair with common reach.

    Raises:
        UnknownNameError: No such arm.
    """
    team = tuple(range(len(stands)))
    if len(team) <= 2 or spots_of(stands, gap_m):
        return MappingProxyType({SHARED: team})
    pairs = {
        name: (first, second)
        for name, (first, second) in zip(
            pair_regions(len(team)), combinations(team, 2), strict=True
        )
        if spots_of((stands[first], stands[second]), gap_m)
    }
    return MappingProxyType(pairs)


@lru_cache(maxsize=64)
def spots_of(stands: tuple[Stand, ...], gap_m: Gap | None) -> tuple[Spot, ...]:
    """Return the positions that all given robots reach with a margin, best first.

    Args:
        stands: The robots.
        gap_m: The gap in the table; None without one.

    Raises:
        UnknownNameError: No such arm.
    """
    spots = []
    reaches = [(reach_of(arm), base) for arm, base in stands]
    left = max(base.x - reach.travel_m for reach, base in reaches)
    right = min(base.x + reach.travel_m for reach, base in reaches)
    half = round(TABLE_HALF_Y_M / _GRID_M)
    for i in range(math.ceil(left / _GRID_M), math.floor(right / _GRID_M) + 1):
        for j in range(-half, half + 1):
            x, y = i * _GRID_M, j * _GRID_M
            if not lies_on_table(gap_m, Pose2(x, y), EDGE_M):
                continue
            margin = math.inf
            for reach, base in reaches:
                margin = min(margin, reach.margin(base, x, y))
                if margin < _MARGIN_M:
                    break
            else:
                spots.append((x, y, min(margin, _GOOD_MARGIN_M)))
    # Largest margin first, and among equal ones the most central.
    return tuple(sorted(spots, key=lambda s: (-s[2], s[0] ** 2 + s[1] ** 2)))
