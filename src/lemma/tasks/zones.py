"""Zones: parts of the table that are defined by the robots' reachable sets.

Exclusion uses the outer bound of the reachable set (:mod:`lemma.robots.could`): an
object that is exclusive to one robot is inside that robot's inner bound
(:mod:`lemma.robots.reach`) and outside the outer bound of all others. So no orientation
of another robot's gripper can touch it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray, Pose2
from lemma.robots.could import Could, could_of
from lemma.robots.reach import Reach, reach_of
from lemma.scene.camera_mounts import CameraFootprint
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M
from lemma.scene.raster import RASTER
from lemma.scene.spec import ObjectPlacement, RobotPlacement
from lemma.scene.table import TABLE_HALF_Y_M, Gap, tops
from lemma.tasks.drags import stick_gap

INSIDE_M = 0.03
"""Smallest margin of a robot's objects inside its reach."""
OUTSIDE_M = 0.03
"""Smallest margin outside a robot's outer bound, for objects that it must not touch."""
REMOTE_M = 0.09
"""Smallest margin outside a robot's outer bound, for objects on which it must not place
anything. A cube that a fingertip just reaches, and that then coasts as far as allowed
(:data:`~lemma.scene.coasting.COAST_M`), does not get there."""

BESIDE_BASE_M = 0.06
"""Smallest gap between an object and the circle that an arm's shoulder sweeps."""
FROM_EDGE_M = 0.01
"""Smallest gap between the disc around an object and the table's edge."""
SLIDE_M = 0.15
"""Bound on the distance that a tower slides after a push; both cubes of a tower
decelerate equally. No object may coast farther than
:data:`~lemma.scene.coasting.COAST_M`, so the bound has a margin of about 10 cm."""
STICK_DIAGONAL_M = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M)
"""Bound on the extension of a robot's reach by the stick, for any grasp."""
_MAP_EDGE_M = 0.06
"""Smallest distance of an object's centre from the edge of the top-down map."""
_FACING_RAD = math.radians(170.0)
"""Largest bearing of objects relative to their robot's front."""
_HIDDEN_RAD = (math.radians(65.0), math.radians(160.0))
"""Bearings between which the parked arm, on the left side, hides near objects."""
_HIDDEN_REACH = 0.8

Mask = NDArray[np.bool_]
Sift = Callable[[ObjectKind, FloatArray, FloatArray], Mask]
"""Returns which positions x, y, (n,) each [m], are valid for a kind of object."""


@dataclass(frozen=True)
class Zone:
    """A set of valid positions for an object."""

    sift: Sift
    """Vectorized check of many positions."""
    check: Callable[[Pose2], bool] | None = None
    """Further check of a single pose; None if there is none."""
    barred: tuple[int, ...] = ()
    """Robots that cannot reach the zone. See :meth:`Territory.keeps_off`."""
    tool: bool = False
    """Whether they cannot reach it even with the stick."""
    draw: Callable[[np.random.Generator], Pose2] | None = None
    """Draws a pose; None if poses are drawn on the whole table and checked."""
    says: str = ""
    """Description for humans: "where ...", with indices of robots in braces."""

    @classmethod
    def where(cls, check: Callable[[Pose2], bool]) -> "Zone":
        """Return the zone of all poses for which a function returns True."""
        return cls(lambda kind, x, y: np.ones(len(x), np.bool_), check)


ZoneLike = Zone | Callable[[Pose2], bool]
"""A zone, or a function that returns whether a pose is valid."""


class Territory:
    """Vectorized checks of the reach of a team's robots."""

    def __init__(
        self, robots: tuple[RobotPlacement, ...], gap_m: Gap | None = None
    ) -> None:
        """Prepare the checks.

        Args:
            robots: The team.
            gap_m: The gap in the table; None without one.
        """
        self.robots = robots
        self.gap_m = gap_m
        self._views = tuple(CameraFootprint(robot) for robot in robots)

    def reach(self, robot: int) -> Reach:
        """Return the inner bound of a robot's reachable set."""
        return reach_of(self.robots[robot].arm)

    def could(self, robot: int) -> Could:
        """Return the outer bound of a robot's reachable set."""
        return could_of(self.robots[robot].arm)

    def only(self, *robots: int, tool: bool = False, beyond_m: float = 0.0) -> Zone:
        """Return the zone that all given robots reach, and no other robot.

        Args:
            robots: Indices of the robots.
            tool: Whether the others must not reach it even with the stick, for example
                to carry a cube there on it.
            beyond_m: Length of another object with which the others must not reach it
                either [m].
        """
        others = tuple(r for r in range(len(self.robots)) if r not in robots)

        def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
            found = np.ones(len(x), np.bool_)
            for robot in robots:
                found &= self.works(robot, x, y)
            for other in others:
                found &= self.cannot(
                    other, kind, x, y, tool=tool, by_m=REMOTE_M + beyond_m
                )
            return found

        who = " and the ".join(f"{{{robot}}}" for robot in robots)
        works = "works" if len(robots) == 1 else "work"
        says = f"where the {who} {works}, and no other robot could do anything"
        if tool:
            says += " even with the stick"
        if beyond_m:
            says += f" even with a bar of {100 * beyond_m:.0f} cm"
        return Zone(sift, barred=others, tool=tool, says=says)

    def nobody(self) -> Zone:
        """Return the zone that no robot can reach."""

        def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
            found = np.ones(len(x), np.bool_)
            for robot in range(len(self.robots)):
                found &= self.cannot(robot, kind, x, y)
            return found

        return Zone(sift, says="where no robot could touch it")

    def anywhere(self) -> Zone:
        """Return the zone without positions between any robot's inner and outer bound.

        There each robot either reaches an object with a margin, or cannot touch it.
        """

        def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
            found = np.ones(len(x), np.bool_)
            for robot in range(len(self.robots)):
                found &= self.works(robot, x, y) | self.cannot(robot, kind, x, y)
            return found

        return Zone(sift, says="where each robot either works or could not touch it")

    def distance(self, robot: int, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the distances of positions x, y, (n,) [m], from a base, (n,) [m]."""
        base = self.robots[robot].base
        distance: FloatArray = np.sqrt((x - base.x) ** 2 + (y - base.y) ** 2)
        return distance

    def works(self, robot: int, x: FloatArray, y: FloatArray) -> Mask:
        """Return which positions x, y, (n,) [m], a robot reaches with a margin."""
        reach, r = self.reach(robot), self.distance(robot, x, y)
        inside: Mask = np.minimum(r - reach.inner_m, reach.travel_m - r) >= INSIDE_M
        return inside

    def cannot(
        self,
        robot: int,
        kind: ObjectKind,
        x: FloatArray,
        y: FloatArray,
        *,
        tool: bool = False,
        by_m: float = OUTSIDE_M,
    ) -> Mask:
        """Return at which positions a robot cannot reach a kind of object.

        Args:
            robot: Index of the robot.
            kind: Kind of the object.
            x: World x, (n,) [m].
            y: World y, (n,) [m].
            tool: Whether the robot holds the stick, by either end.
            by_m: Margin outside the outer bound [m].

        Returns:
            One flag per position, (n,).
        """
        safe_m = self.safe_m(robot, kind, tool=tool) + by_m
        return self.distance(robot, x, y) >= safe_m

    def keeps_off(
        self, robot: int, placed: ObjectPlacement, row_m: float, *, tool: bool = False
    ) -> bool:
        """Return whether an object is out of reach even for pushed towers of cubes.

        If a robot pushes a tower against an object, the upper cube may slide or tip
        onto it. So the distance must exceed the length of a row of cubes plus the
        distance that a tower slides.

        Args:
            robot: Index of the robot.
            placed: The object.
            row_m: Length of a row of all objects that the robot could push [m].
            tool: Whether the robot holds the stick.
        """
        kind, at = placed.entity.kind, placed.pose
        safe_m = self.safe_m(robot, kind, tool=tool) + OUTSIDE_M + row_m + SLIDE_M
        return self.robots[robot].base.distance(at) >= safe_m

    def safe_m(self, robot: int, kind: ObjectKind, *, tool: bool = False) -> float:
        """Return the distance from a robot's base beyond which it cannot reach [m].

        Args:
            robot: Index of the robot.
            kind: Kind of the object to reach.
            tool: Whether the robot holds the stick.
        """
        safe_m = self.could(robot).radius_m(kind.disc_m, kind.support_m or 0.0)
        return safe_m + (STICK_DIAGONAL_M if tool else 0.0)

    def on_table(self, x: FloatArray, y: FloatArray, edge_m: float) -> Mask:
        """Return which positions x, y, (n,) [m], are ``edge_m`` inside a table top."""
        inside = np.zeros(len(x), np.bool_)
        for left, right in tops(self.gap_m):
            inside |= (x >= left + edge_m) & (x <= right - edge_m)
        inside &= np.abs(y) <= TABLE_HALF_Y_M - edge_m
        return inside

    def in_view(self, x: FloatArray, y: FloatArray) -> Mask:
        """Return which positions x, y, (n,) [m], are in view of a robot's camera.

        They must also be in front of that robot and on the top-down map.
        """
        along_x, along_y = (0.5 * size - _MAP_EDGE_M for size in RASTER.size_m)
        on_map = (np.abs(x) <= along_x) & (np.abs(y) <= along_y)
        seen = np.zeros(len(x), np.bool_)
        for robot, view in enumerate(self._views):
            base = self.robots[robot].base
            cos, sin = math.cos(base.yaw), math.sin(base.yaw)
            ahead = cos * (x - base.x) + sin * (y - base.y)
            left = cos * (y - base.y) - sin * (x - base.x)
            r = self.distance(robot, x, y)
            from_rad, to_rad = (r * math.cos(bearing) for bearing in _HIDDEN_RAD)
            hidden = (left > 0.0) & (ahead <= from_rad) & (ahead >= to_rad)
            hidden &= r < _HIDDEN_REACH * self.reach(robot).travel_m
            around = ahead >= r * math.cos(_FACING_RAD)
            seen |= on_map & around & ~hidden & view.sees(x, y)
        return seen


def beside_base_m(kind: ObjectKind) -> float:
    """Return the least distance from the area swept around a base to a centre [m]."""
    return max(BESIDE_BASE_M, kind.disc_m)


def gap_m(
    kind: ObjectKind, pose: Pose2, other: ObjectKind | None, place: Pose2
) -> float:
    """Return the distance of an object from another or from a base [m].

    Distances are between centres, but from the axes of a stick.

    Args:
        kind: Kind of the object.
        pose: World from object.
        other: Kind of the other object; None for a robot's base.
        place: World from the other object or base.
    """
    if kind.tool:
        return stick_gap(pose, place.x, place.y)
    if other is not None and other.tool:
        return stick_gap(place, pose.x, pose.y)
    return pose.distance(place)
