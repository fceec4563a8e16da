"""Parts of the table, by who could do what there.

Robots are kept apart by what they *could* do (:mod:`lemma.robots.could`), not by what
they are told to do: what is exclusive to one robot works for it and is out of every
other's possibilities, whatever the others do with their hands.
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

INSIDE_M = 0.03
"""How far inside its reach a robot's objects are, at least."""
OUTSIDE_M = 0.03
"""How far outside of its possibilities lies what a robot shall not touch, at least."""
REMOTE_M = 0.09
"""How far outside of its possibilities lies that on which it shall put nothing, at
least. A cube whose near edge a fingertip touches, and that then moves on by itself as
far as it may (:data:`~lemma.scene.coasting.COAST_M`), does not get there."""

FROM_EDGE_M = 0.01
"""Between the disc around an object and the table's edge, at least."""
SLIDE_M = 0.15
"""How far a tower that a hand has pushed slides on, at most: two cubes that lie on each
other slow down alike. Since nothing may coast farther than
:data:`~lemma.scene.coasting.COAST_M`, this has a margin of 10 cm."""
STICK_DIAGONAL_M = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M)
"""How much farther the stick lets a robot do anything, however it is held."""
_MAP_EDGE_M = 0.06
"""Things lie on the top-down map as a whole."""
_FACING_RAD = math.radians(170.0)
"""Objects lie around their robot, but not straight behind it."""
_HIDDEN_RAD = (math.radians(65.0), math.radians(160.0))
"""The waiting arm, at the left side, hides what is near between these bearings."""
_HIDDEN_REACH = 0.8

Mask = NDArray[np.bool_]
Sift = Callable[[ObjectKind, FloatArray, FloatArray], Mask]
"""Which of many positions (n,), (n,) [m] suit a kind of object."""


@dataclass(frozen=True)
class Zone:
    """Where something may lie."""

    sift: Sift
    """Looks at many positions at once."""
    check: Callable[[Pose2], bool] | None = None
    """Looks at one that was not sifted out; None if nothing is left to check."""
    barred: tuple[int, ...] = ()
    """Robots that could do nothing there. See :meth:`Territory.keeps_off`."""
    tool: bool = False
    """Whether they could do nothing even with the stick in their hand."""
    says: str = ""
    """Where that is, for people: "where ..." with robots by number in braces."""

    @classmethod
    def where(cls, check: Callable[[Pose2], bool]) -> "Zone":
        """Return the poses for which a function is true; for zones of one's own."""
        return cls(lambda kind, x, y: np.ones(len(x), np.bool_), check)


ZoneLike = Zone | Callable[[Pose2], bool]
"""A zone, or a function that is true where something may lie."""


class Territory:
    """Reach of each robot over many positions of the table at once."""

    def __init__(
        self, robots: tuple[RobotPlacement, ...], gap_m: Gap | None = None
    ) -> None:
        """Prepare for a team.

        Args:
            robots: The team.
            gap_m: Where the table is missing.
        """
        self.robots = robots
        self.gap_m = gap_m
        self._views = tuple(CameraFootprint(robot) for robot in robots)

    def reach(self, robot: int) -> Reach:
        """Return where a robot surely works."""
        return reach_of(self.robots[robot].arm)

    def could(self, robot: int) -> Could:
        """Return where a robot could possibly do anything."""
        return could_of(self.robots[robot].arm)

    def only(self, *robots: int, tool: bool = False, beyond_m: float = 0.0) -> Zone:
        """Where one robot works, or each of some, and no other could do anything.

        Args:
            robots: Which.
            tool: Whether the others could do nothing even with the stick in their
                hand, such as to carry a cube there on it.
            beyond_m: How long another thing is with which they could do nothing either
                [m].
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
        """Where no robot could do anything."""

        def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
            found = np.ones(len(x), np.bool_)
            for robot in range(len(self.robots)):
                found &= self.cannot(robot, kind, x, y)
            return found

        return Zone(sift, says="where no robot could touch it")

    def anywhere(self) -> Zone:
        """Where each robot either surely works or could do nothing."""

        def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
            found = np.ones(len(x), np.bool_)
            for robot in range(len(self.robots)):
                found &= self.works(robot, x, y) | self.cannot(robot, kind, x, y)
            return found

        return Zone(sift, says="where each robot either works or could not touch it")

    def distance(self, robot: int, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return how far positions are from a robot's base, (n,) [m]."""
        base = self.robots[robot].base
        distance: FloatArray = np.sqrt((x - base.x) ** 2 + (y - base.y) ** 2)
        return distance

    def works(self, robot: int, x: FloatArray, y: FloatArray) -> Mask:
        """Return which positions are surely in a robot's reach."""
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
        """Return at which positions a robot could do nothing to a kind of thing.

        Args:
            robot: Which.
            kind: Of thing.
            x: World positions, (n,) [m].
            y: World positions, (n,) [m].
            tool: Whether with the stick in its hand, held by either end.
            by_m: How far beyond its possibilities they are, at least [m].
        """
        safe_m = self.safe_m(robot, kind, tool=tool) + by_m
        return self.distance(robot, x, y) >= safe_m

    def keeps_off(
        self, robot: int, placed: ObjectPlacement, row_m: float, *, tool: bool = False
    ) -> bool:
        """Return whether a robot cannot even push a tower to a thing.

        A cube is put upon something out of reach if it is the upper one of two that
        are pushed there: where the lower one is stopped, it slides or tips over. So the
        distance must be more than a row of cubes is long, and than it slides on.

        Args:
            robot: Which.
            placed: The thing.
            row_m: Length of a row of all that it could push.
            tool: Whether with the stick in its hand.
        """
        kind, at = placed.entity.kind, placed.pose
        safe_m = self.safe_m(robot, kind, tool=tool) + OUTSIDE_M + row_m + SLIDE_M
        return self.robots[robot].base.distance(at) >= safe_m

    def safe_m(self, robot: int, kind: ObjectKind, *, tool: bool = False) -> float:
        """Return the distance from which on a robot could do nothing to a thing."""
        safe_m = self.could(robot).radius_m(kind.disc_m, kind.support_m or 0.0)
        return safe_m + (STICK_DIAGONAL_M if tool else 0.0)

    def on_table(self, x: FloatArray, y: FloatArray, edge_m: float) -> Mask:
        """Return which positions are on a table top, so far from its edges [m]."""
        inside = np.zeros(len(x), np.bool_)
        for left, right in tops(self.gap_m):
            inside |= (x >= left + edge_m) & (x <= right - edge_m)
        inside &= np.abs(y) <= TABLE_HALF_Y_M - edge_m
        return inside

    def in_view(self, x: FloatArray, y: FloatArray) -> Mask:
        """Return which positions lie before some robot, in its camera's view."""
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
