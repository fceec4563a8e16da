"""The table: one top, or two with a gap between them."""

from lemma.core.poses import Pose2

TABLE_HALF_X_M = 1.70
TABLE_HALF_Y_M = 1.70
TABLE_THICKNESS_M = 0.04
FLOOR_Z_M = -0.75
"""Height of the floor, where fallen objects lie [m]."""

Gap = tuple[float, float]
"""Gap in the table over its whole depth: x from and to [m]."""


def tops(gap: Gap | None) -> tuple[tuple[float, float], ...]:
    """Return x from and to of each table top, from left to right [m]."""
    if gap is None:
        return ((-TABLE_HALF_X_M, TABLE_HALF_X_M),)
    return ((-TABLE_HALF_X_M, gap[0]), (gap[1], TABLE_HALF_X_M))


def lies_on_table(gap: Gap | None, pose: Pose2, edge_m: float = 0.0) -> bool:
    """Return whether a position is on a table top, ``edge_m`` or more from its edge."""
    if abs(pose.y) > TABLE_HALF_Y_M - edge_m:
        return False
    return any(left + edge_m <= pose.x <= right - edge_m for left, right in tops(gap))
