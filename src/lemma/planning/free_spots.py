"""Free places in a region that several robots share."""

import math

from lemma.core.poses import Pose2
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M, STICK_SECTION_M
from lemma.scene.regions import EDGE_M, spots_of
from lemma.scene.spec import RobotPlacement
from lemma.scene.table import Gap, lies_on_table
from lemma.tasks.drags import (
    HAND_CLEARANCE_M,
    LARGEST_HEADING_RAD,
    Disc,
    heading_from,
    is_turned_too_far,
    stick_gap,
    stick_in_grasp,
)

_CLEARANCE_M = 0.065
"""From a cube's centre to the edge of anything else: fingers fit between."""
_GOOD_CLEARANCE_M = 0.12
_STICK_CLEARANCE_M = STICK_SECTION_M / 2 + 0.02
_STICK_GRID = 3
_STICK_YAWS = 24

_StickKey = tuple[tuple[Disc, ...], Pose2, Pose2]


class FreeSpots:
    """Chooses where to put things down so that others can pick them up again."""

    def __init__(
        self, robots: tuple[RobotPlacement, ...], gap_m: Gap | None = None
    ) -> None:
        """Find the places that some robots share.

        Args:
            robots: Those of one region.
            gap_m: Where the table is missing.
        """
        self._gap_m = gap_m
        self._spots = spots_of(tuple((r.arm, r.base) for r in robots), gap_m)
        self._bases = tuple(robot.base for robot in robots)
        self._stick_places: dict[_StickKey, Pose2 | None] = {}

    def free_spot(
        self, obstacles: tuple[Disc, ...], wider_m: float = 0.0
    ) -> Pose2 | None:
        """Return the best place for a cube: well inside reach, clear of the rest.

        Args:
            obstacles: Discs of the objects around.
            wider_m: By how much more room is needed than for a cube [m].
        """
        best, best_score = None, -math.inf
        for x, y, margin in self._spots:
            if margin + _GOOD_CLEARANCE_M <= best_score:
                break
            clearance = _GOOD_CLEARANCE_M
            for ox, oy, radius in obstacles:
                gap = math.hypot(ox - x, oy - y) - radius - wider_m
                if gap < clearance:
                    clearance = gap
                    if clearance < _CLEARANCE_M:
                        break
            else:
                if margin + clearance > best_score:
                    best, best_score = Pose2(x, y), margin + clearance
        return best

    def free_stick(
        self, obstacles: tuple[Disc, ...], base: Pose2, pick: Pose2
    ) -> Pose2 | None:
        """Return the best gripper pose to lay the stick down for somebody else.

        Args:
            obstacles: Discs of the objects around.
            base: Of the robot that brings it.
            pick: Gripper pose where that robot grasps it.
        """
        key = (obstacles, base, pick)
        if key not in self._stick_places:
            self._stick_places[key] = next(
                (
                    grip
                    for x, y, _ in self._spots[::_STICK_GRID]
                    for grip in self._stick_poses(x, y)
                    if not is_turned_too_far(base, pick, grip)
                    and _stick_is_free(grip, obstacles, self._gap_m)
                ),
                None,
            )
        return self._stick_places[key]

    def _stick_poses(self, x: float, y: float) -> list[Pose2]:
        """Return gripper poses at a place that suit each robot, best first."""

        def worst(grip: Pose2) -> float:
            stick = stick_in_grasp(grip)
            return max(heading_from(base, stick) for base in self._bases)

        poses = [Pose2(x, y, math.tau * k / _STICK_YAWS) for k in range(_STICK_YAWS)]
        able = [pose for pose in poses if worst(pose) <= LARGEST_HEADING_RAD]
        return sorted(able, key=worst)


def _stick_is_free(grip: Pose2, obstacles: tuple[Disc, ...], gap_m: Gap | None) -> bool:
    stick = stick_in_grasp(grip)
    for corner in (
        stick,
        stick @ Pose2(HANDLE_LENGTH_M, 0.0),
        stick @ Pose2(HANDLE_LENGTH_M, HOOK_LENGTH_M),
    ):
        if not lies_on_table(gap_m, corner, EDGE_M):
            return False
    return all(
        stick_gap(stick, x, y) > radius + _STICK_CLEARANCE_M
        and math.hypot(x - grip.x, y - grip.y) > radius + HAND_CLEARANCE_M
        for x, y, radius in obstacles
    )
