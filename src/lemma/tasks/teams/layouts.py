"""Layouts: where the robots of a team stand, and which of them are neighbors.

Two robots stand face to face. More stand so far apart that neighbors share a strip of
the table, in a row, a bent chain, a triangle or a square.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from lemma.core.poses import Pose2
from lemma.core.registry import Registry, check_fields
from lemma.core.seeding import ordered_sum
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.rod import ROD_LENGTH_M
from lemma.scene.spec import PAIR_COLORS, ROBOT_COLORS, RobotPlacement
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M, Gap
from lemma.tasks.zones import FROM_EDGE_M, OUTSIDE_M

SHARED_WIDTH_M = (0.16, 0.30)
"""Width of the region where both robots of a pair work, along the line between them."""
_FIXED_WIDTH_M = 0.18
"""The same where robots always stand in the same places. In a wider region of two UR5
no place is left for what only a hook gets."""
APART_M = (-0.02, 0.05)
"""How much farther apart robots stand than a cube between them needs that neither could
touch; the stick bridges little more."""
_GAP_WIDTH_M = 0.20
"""Width of the gap in the table. A cube that is dragged into it falls."""
LATERAL_M = 0.05
"""How far a robot stands from the line through the middle of the table, at most."""
YAW_RAD = 0.10
"""How far it is turned away from that line, at most."""
FOOT_M = 0.15
"""A robot's base stands so far from the edge of the table, at least."""

Bases = Sequence[Pose2]
Split = Callable[[Sequence[RobotPlacement]], Gap]
"""The gap in the table, from where the robots stand."""
Shape = Callable[[Sequence[float], np.random.Generator], Bases]
"""Bases, anywhere, from how far apart neighbors stand [m], in the order of
``neighbors``."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """One way to stand around the table."""

    name: str
    """Registry name: ``"triangle"``."""
    summary: str
    """One sentence for people."""
    size: int
    """Robots."""
    neighbors: tuple[tuple[int, int], ...]
    """Robots that share a strip of the table, as indices in the team."""
    width: tuple[float, float]
    """Least and largest width of that strip, as a share of the smaller reach."""
    orders: tuple[tuple[int, ...], ...]
    """The teams' orders by role: those in which neighbors stay neighbors."""
    shape: Shape
    """Where they stand, from the distances of neighbors."""
    split: Split | None = None
    """Where the table is missing between them; None for a whole table. Then robots
    stand along x."""

    def __post_init__(self) -> None:
        """Check the types."""
        check_fields("layout", self.name, self)

    def distances_m(
        self, team: Sequence[str], widths: Sequence[float]
    ) -> tuple[float, ...]:
        """Return how far apart neighbors stand [m].

        Args:
            team: Arm types.
            widths: Of the strip of each pair of neighbors, as a share of the smaller
                reach.
        """
        reach = [reach_of(arm).travel_m for arm in team]
        return tuple(
            reach[i] + reach[j] - width * min(reach[i], reach[j])
            for (i, j), width in zip(self.neighbors, widths, strict=True)
        )

    def place(
        self, team: Sequence[str], rng: np.random.Generator
    ) -> tuple[RobotPlacement, ...] | None:
        """Stand the robots of a team of three or more around the table.

        Args:
            team: Arm types.
            rng: Where draws come from.

        Returns:
            The robots, each of another color; None where one of them would stand too
            near to an edge of the table.
        """
        widths = [rng.uniform(*self.width) for _ in self.neighbors]
        bases = self.shape(self.distances_m(team, widths), rng)
        turns = int(rng.integers(4))
        if self.split is not None:
            turns -= turns % 2
        quarter = Pose2(0.0, 0.0, 0.5 * math.pi * turns)
        turned = [quarter @ base for base in bases]
        x, y = ([base.xy[axis] for base in turned] for axis in (0, 1))
        middle = (0.5 * (min(x) + max(x)), 0.5 * (min(y) + max(y)))
        colors = [ROBOT_COLORS[int(i)] for i in rng.permutation(len(ROBOT_COLORS))]
        robots = []
        for arm, color, base in zip(team, colors, turned, strict=False):
            yaw = base.yaw + rng.uniform(-YAW_RAD, YAW_RAD)
            at = Pose2(base.x - middle[0], base.y - middle[1], yaw).rounded()
            robots.append(RobotPlacement(arm, color, at))
        return tuple(robots) if all(map(stands_on_table, robots)) else None

    def allows(self, robots: Sequence[RobotPlacement]) -> bool:
        """Whether robots stand so far apart as :meth:`place` may have placed them."""
        if len(robots) != self.size or not all(map(stands_on_table, robots)):
            return False
        team, count = [robot.arm for robot in robots], len(self.neighbors)
        near, far = (self.distances_m(team, [w] * count) for w in self.width[::-1])
        return all(
            near[k] - 1e-3 <= robots[i].base.distance(robots[j].base) <= far[k] + 1e-3
            for k, (i, j) in enumerate(self.neighbors)
        )


PAIR = "pair"
"""Layout of two robots that :func:`place_pair` stands face to face."""
LAYOUTS: Registry[Layout] = Registry("layout", Layout)
"""Every layout by name."""


def stands_on_table(robot: RobotPlacement) -> bool:
    """Whether a base is far enough from the edges of the table."""
    x, y = (abs(at) for at in robot.base.xy)
    return x <= TABLE_HALF_X_M - FOOT_M and y <= TABLE_HALF_Y_M - FOOT_M


def place_pair(
    team: tuple[str, ...],
    order: tuple[int, ...],
    rng: np.random.Generator,
    *,
    fixed: bool,
    apart: bool,
) -> tuple[tuple[RobotPlacement, ...], Gap | None]:
    """Stand two robots face to face, so far apart as a task wants.

    Args:
        team: Arm types.
        order: The robots by role.
        rng: Where draws come from.
        fixed: Whether they always stand in the same places.
        apart: Whether they share no region.

    Returns:
        The robots, and where the table is missing between them.
    """

    def drawn(low: float, high: float, always: float) -> float:
        return always if fixed else rng.uniform(low, high)

    first, second = (reach_of(arm) for arm in team)
    if apart:
        distance = apart_m(team, order) + drawn(*APART_M, 0.0)
    else:
        shared = drawn(*SHARED_WIDTH_M, _FIXED_WIDTH_M)
        distance = first.travel_m + second.travel_m - shared
    # The middle of the region between them is the middle of the table.
    left = 0.5 * (distance + first.travel_m - second.travel_m)
    x = (-left, distance - left)
    robots = []
    for i in range(2):
        facing = 0.0 if i == 0 else math.pi
        base = Pose2(
            x[i],
            drawn(-LATERAL_M, LATERAL_M, 0.0),
            facing + drawn(-YAW_RAD, YAW_RAD, 0.0),
        ).rounded()
        color = PAIR_COLORS[i if fixed else int(rng.integers(len(PAIR_COLORS)))]
        robots.append(RobotPlacement(team[i], color, base))
    return tuple(robots), gap_beyond(tuple(robots), order[0]) if apart else None


def apart_m(team: tuple[str, ...], order: tuple[int, ...]) -> float:
    """Return how far apart robots stand so that a cube fits between them.

    Neither could touch it. It lies on the table top of the second, beyond the gap,
    where the first brings nothing and pulls nothing home.
    """
    user, receiver = (could_of(team[i]) for i in order[:2])
    edge = user.place_m + OUTSIDE_M
    cube = CUBE.disc_m + FROM_EDGE_M
    beyond: float = receiver.radius_m(CUBE.disc_m) + OUTSIDE_M
    return edge + cube + beyond


def gap_beyond(robots: tuple[RobotPlacement, ...], user: int) -> Gap:
    """Return a gap beyond which a robot could put nothing."""
    robot = robots[user]
    beyond = could_of(robot.arm).place_m + OUTSIDE_M
    if user == 0:
        far = robot.base.x + beyond
        return round(far - _GAP_WIDTH_M, 4), round(far, 4)
    far = robot.base.x - beyond
    return round(far, 4), round(far + _GAP_WIDTH_M, 4)


def gap_out_of_reach(robots: Sequence[RobotPlacement]) -> Gap:
    """Return a gap so wide that nobody could touch a rod on another one's table top.

    That is a rod of which the middle lies on the table. It falls into the gap, which is
    wider than it is long.
    """
    left, right = sorted(robots, key=lambda robot: robot.base.x)
    beyond_m = OUTSIDE_M + 0.5 * ROD_LENGTH_M
    far = [could_of(robot.arm).touch_m + beyond_m for robot in (right, left)]
    return round(right.base.x - far[0], 4), round(left.base.x + far[1], 4)


def _chain(least_rad: float, most_rad: float) -> Shape:
    """Return the shape of a line of robots that bends at each inner one.

    Everybody looks at the side to which it bends.
    """

    def shape(distances: Sequence[float], rng: np.random.Generator) -> Bases:
        inner = len(distances) - 1
        bends = [rng.uniform(least_rad, most_rad) for _ in range(inner)]
        # The first two along x: a bent chain takes least room so.
        headings = [0.0]
        for bend in bends:
            headings.append(headings[-1] + bend)
        x, y, spots = 0.0, 0.0, [(0.0, 0.0)]
        for distance, heading in zip(distances, headings, strict=True):
            x, y = x + distance * math.cos(heading), y + distance * math.sin(heading)
            spots.append((x, y))
        ahead = [headings[0], *(0.5 * (a + b) for a, b in pairwise(headings))]
        ahead.append(headings[-1])
        return [
            Pose2(*spot, heading + 0.5 * math.pi)
            for spot, heading in zip(spots, ahead, strict=True)
        ]

    return shape


def _triangle(distances: Sequence[float], rng: np.random.Generator) -> Bases:
    """Return a triangle of three side lengths; everybody looks at the middle."""
    a, b, c = distances
    spots = [(0.0, 0.0), (a, 0.0), _corner(a, c, b)]
    return _facing_middle(spots)


def _square(distances: Sequence[float], rng: np.random.Generator) -> Bases:
    """Return a quadrangle of four side lengths with a right angle at the second."""
    a, b, c, d = distances
    # The first at the origin, the third along x.
    diagonal = math.hypot(a, b)
    second, fourth = _corner(diagonal, a, b), _corner(diagonal, d, c)
    spots = [(0.0, 0.0), (second[0], -second[1]), (diagonal, 0.0), fourth]
    # So that sides, and not diagonals, lie along the edges of the table.
    cos = sin = math.sqrt(0.5)
    return _facing_middle([(cos * x - sin * y, sin * x + cos * y) for x, y in spots])


def _corner(base: float, left: float, right: float) -> tuple[float, float]:
    """Return the point that is so far from both ends of a base along x, above it."""
    x = (base * base + left * left - right * right) / (2.0 * base)
    return x, math.sqrt(max(0.0, left * left - x * x))


def _facing_middle(spots: Sequence[tuple[float, float]]) -> Bases:
    mx, my = (ordered_sum(s[axis] for s in spots) / len(spots) for axis in (0, 1))
    return [Pose2(x, y, math.atan2(my - y, mx - x)) for x, y in spots]


def _pair(distances: Sequence[float], rng: np.random.Generator) -> Bases:
    (distance,) = distances
    return [Pose2(0.0, 0.0), Pose2(distance, 0.0, math.pi)]


_LINE = ((0, 1), (1, 2))
_BOTH_WAYS = ((0, 1, 2), (2, 1, 0))
_AROUND = tuple(
    tuple((first + way * k) % 4 for k in range(4))
    for first in range(4)
    for way in (1, -1)
)
_NARROW = (0.25, 0.32)
"""Of the strips in a row and a square: 20 to 26 cm of two UR5."""

LAYOUTS.add(
    PAIR,
    Layout(
        name=PAIR,
        summary="Two robots stand face to face.",
        size=2,
        neighbors=((0, 1),),
        width=(0.12, 0.38),
        orders=((0, 1), (1, 0)),
        shape=_pair,
    ),
)
LAYOUTS.add(
    "wide_pair",
    Layout(
        name="wide_pair",
        summary="Two robots stand face to face, too far apart to share a place.",
        size=2,
        neighbors=((0, 1),),
        width=(-0.34, -0.15),
        orders=((0, 1), (1, 0)),
        shape=_pair,
    ),
)
LAYOUTS.add(
    "gap_pair",
    Layout(
        name="gap_pair",
        summary="Two robots stand face to face, with a gap in the table between them.",
        size=2,
        neighbors=((0, 1),),
        width=(-0.13, -0.07),
        orders=((0, 1), (1, 0)),
        shape=_pair,
        split=gap_out_of_reach,
    ),
)
LAYOUTS.add(
    "row",
    Layout(
        name="row",
        summary="Three robots stand in a line and look to one side.",
        size=3,
        neighbors=_LINE,
        width=_NARROW,
        orders=_BOTH_WAYS,
        shape=_chain(math.radians(-5.0), math.radians(5.0)),
    ),
)
LAYOUTS.add(
    "chain",
    Layout(
        name="chain",
        summary="Three robots stand in a line that bends by 10 to 60 degrees.",
        size=3,
        neighbors=_LINE,
        width=_NARROW,
        orders=_BOTH_WAYS,
        shape=_chain(math.radians(10.0), math.radians(60.0)),
    ),
)
LAYOUTS.add(
    "triangle",
    Layout(
        name="triangle",
        summary="Three robots stand around a region that all of them share.",
        size=3,
        neighbors=((0, 1), (1, 2), (2, 0)),
        width=(0.58, 0.64),
        orders=tuple(permutations(range(3))),
        shape=_triangle,
    ),
)
LAYOUTS.add(
    "square",
    Layout(
        name="square",
        summary="Four robots stand at the corners; each shares a region with the next.",
        size=4,
        neighbors=((0, 1), (1, 2), (2, 3), (3, 0)),
        width=(0.34, 0.40),
        orders=_AROUND,
        shape=_square,
    ),
)
