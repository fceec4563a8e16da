"""Regions: parts of the table in which several robots work, derived from their bases.

A region is a place for sub-tasks: somebody puts a thing down there, somebody else takes
it. The region of a whole team is called ``"shared"``. Where no place is reached by the
whole team, each pair of robots that has one has a region: ``"shared_01"`` is that of
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
"""Things are put down no nearer to an edge of the table than this [m]."""

_GRID_M = 0.02
_MARGIN_M = 0.03
_GOOD_MARGIN_M = 0.10

Stand = tuple[str, Pose2]
"""Arm type and base of a robot."""
Spot = tuple[float, float, float]
"""x, y, and the smallest margin of any robot there, where more is no better [m]."""


@lru_cache(maxsize=64)
def regions_of(
    stands: tuple[Stand, ...], gap_m: Gap | None
) -> Mapping[str, tuple[int, ...]]:
    """Return the regions of a team.

    Args:
        stands: The robots.
        gap_m: Where the table is missing.

    Returns:
        The robots of each region, as indices in the team: ``{"shared": (0, 1, ...)}``
        for one or two robots, and for more where all of them reach a place. Otherwise
        a region for each pair that shares one.
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
    """Return the places that all of some robots reach with a margin, best first.

    Args:
        stands: The robots.
        gap_m: Where the table is missing.
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
    # Best first, and among equals the most central.
    return tuple(sorted(spots, key=lambda s: (-s[2], s[0] ** 2 + s[1] ** 2)))
