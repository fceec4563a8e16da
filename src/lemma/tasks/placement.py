"""Placement of objects in zones that are defined by the robots' reach.

A task places an object in a zone, such as "only this robot reaches it". The placer
finds a pose by rejection sampling, as in the paper, and keeps track of the placed
objects. If it finds no pose, the attempt is discarded and a new one begins. Zones are
defined in :mod:`lemma.tasks.zones`.
"""

import math
from collections.abc import Callable

import numpy as np

from lemma.core.errors import InvalidConfigError, SamplingError
from lemma.core.poses import FloatArray, Pose2
from lemma.core.seeding import ordered_sum
from lemma.robots.collision_model import sweep_radius_m
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_KIND,
    STICK_SECTION_M,
)
from lemma.scene.spec import ObjectPlacement, RobotPlacement
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M, Gap
from lemma.tasks.drags import (
    LARGEST_HEADING_RAD,
    MAX_DRAG_M,
    MIN_DRAG_M,
    Disc,
    find_drag,
    grasp_on_stick,
    heading_from,
)
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import Primitive
from lemma.tasks.teams.coalitions import needed
from lemma.tasks.zones import (
    FROM_EDGE_M,
    Mask,
    Territory,
    Zone,
    ZoneLike,
    beside_base_m,
    gap_m,
)

_DRAWS = 2048
"""Number of positions that are drawn at once."""
_ROUNDS = 4
_CHECKS = 40
"""Largest number of positions per draw that are checked one by one."""
_STICK_EDGE_M = 0.05

_KINDS = ("cube", "pad")  # Their colors are shuffled first, in this order.

_OUTLINE = (
    *((HANDLE_LENGTH_M * i / 5, 0.0) for i in range(6)),
    (HANDLE_LENGTH_M - STICK_SECTION_M / 2, HOOK_LENGTH_M - STICK_SECTION_M / 2),
)
"""Points along the stick's axes, in its frame [m]."""


class PlacementError(Exception):
    """An attempt at placing the objects failed; another one may succeed."""


class ObjectPlacer:
    """Robots and placed objects of an instance that is being sampled."""

    def __init__(
        self,
        robots: tuple[RobotPlacement, ...],
        rng: np.random.Generator,
        order: tuple[int, ...] | None = None,
        gap_m: Gap | None = None,
    ) -> None:
        """Start without objects.

        Args:
            robots: The team.
            rng: Random generator.
            order: Indices of the robots by role; drawn if None.
            gap_m: The gap in the table; None without one.
        """
        self.robots = robots
        self.rng = rng
        self.gap_m = gap_m
        self.rule = ""
        """Kind of the goal's rule, for a task with rules; else empty."""
        self.objects: list[ObjectPlacement] = []
        self.territory = Territory(robots, gap_m)
        self.only = self.territory.only
        self.nobody = self.territory.nobody
        self.anywhere = self.territory.anywhere
        self._free = {kind: self._shuffled() for kind in _KINDS}
        self._drags: list[tuple[Primitive, int, int, int]] = []
        self._zones: dict[str, Zone] = {}
        drawn = order if order is not None else rng.permutation(len(robots))
        self.order: tuple[int, ...] = tuple(int(i) for i in drawn)
        """Indices of the robots by role, in random order."""

    def choose(self, count: int) -> int:
        """Draw a number from 0 to below ``count``: a variant of the table."""
        return int(self.rng.integers(count))

    def cube(self, zone: ZoneLike, color: str | None = None) -> str:
        """Place a cube in a zone; see :meth:`put`."""
        return self.put("cube", zone, color)

    def pad(self, zone: ZoneLike, color: str | None = None) -> str:
        """Place a pad in a zone; see :meth:`put`."""
        return self.put("pad", zone, color)

    def put(
        self,
        kind: str,
        zone: ZoneLike,
        color: str | None = None,
        mass_kg: float | None = None,
    ) -> str:
        """Place an object in a zone.

        Args:
            kind: A name in :data:`~lemma.scene.objects.kind.OBJECT_KINDS`.
            zone: The zone.
            color: Its color. If None, one of the benchmark's colors that no object of
                the kind has; colors of users must be named.
            mass_kg: Its mass [kg]; that of the kind if None.

        Returns:
            The entity's name.

        Raises:
            UnknownNameError: No such kind or color.
            InvalidConfigError: The kind is placed by a method of its own.
            SamplingError: The kind has no such color left.
            PlacementError: No pose was found.
        """
        record = OBJECT_KINDS[kind]
        if record.tool:
            raise InvalidConfigError(f"A {kind} is placed by placer.{kind}(robot).")
        free = self._free.get(kind)
        if free is None:
            free = self._free[kind] = self._shuffled() if record.colored else [kind]
        if color is None and not free:
            raise SamplingError(
                f"A task asks for more than {len(BENCHMARK_COLORS)} {kind}s; there is "
                "one of each color. Ask for fewer, or name another color."
            )
        if any((o.kind, o.color) == (kind, color) for o in self.objects):
            raise SamplingError(f"A task asks for a second {color} {kind}.")
        wanted = zone if isinstance(zone, Zone) else Zone.where(zone)
        draw, chosen = wanted.draw, color or free[0]
        pose = draw(self.rng).rounded() if draw else self._find(record, wanted)
        free[:] = [left for left in free if left != chosen]
        placed = ObjectPlacement(kind, chosen, pose, mass_kg)
        self.objects.append(placed)
        self._zones[placed.name] = wanted
        return placed.name

    def has_colors(self, kind: str) -> bool:
        """Return whether a color is left for another cube or pad."""
        return bool(self._free[kind])

    def _shuffled(self) -> list[str]:
        return [str(color) for color in self.rng.permutation(list(BENCHMARK_COLORS))]

    def stick(self, robot: int) -> str:
        """Place the stick where only one robot reaches it; raise PlacementError."""
        base = self.robots[robot].base
        pose = self._search(
            STICK_KIND,
            lambda x, y, yaw: self.suits_stick(robot, x, y, yaw),
            lambda pose: heading_from(base, pose) <= LARGEST_HEADING_RAD,
        )
        self.objects.append(ObjectPlacement("stick", "yellow", pose))
        return self.objects[-1].name

    def suits_stick(
        self, robot: int, x: FloatArray, y: FloatArray, yaw: FloatArray
    ) -> Mask:
        """Return which poses of the stick only one robot reaches, ignoring objects.

        Args:
            robot: Index of the robot that must be able to pick it up.
            x: World x, (n,) [m].
            y: World y, (n,) [m].
            yaw: Directions of its handle, (n,) [rad].
        """
        only = self.only(robot)
        others = [r for r in range(len(self.robots)) if r != robot]
        # Functions of ``math``, because NumPy's results differ between CPUs.
        cos = np.array([math.cos(angle) for angle in yaw.tolist()])
        sin = np.array([math.sin(angle) for angle in yaw.tolist()])
        at = [(x + u * cos - v * sin, y + u * sin + v * cos) for u, v in _OUTLINE]
        grasp = grasp_on_stick(Pose2(0.0, 0.0)).x
        fits = only.sift(STICK_KIND, x + grasp * cos, y + grasp * sin)
        for u, v in at:
            fits &= self.territory.on_table(u, v, _STICK_EDGE_M)
            fits &= self.territory.in_view(u, v)
            for other in others:
                fits &= self.territory.cannot(other, STICK_KIND, u, v)
        return fits

    def tool_only(
        self,
        primitive: Primitive,
        robot: int,
        partner: int,
        kind: str = "cube",
        *,
        alone: bool = False,
    ) -> Zone:
        """Return the zone out of all robots' reach in which one use of the stick helps.

        Args:
            primitive: ``HOOK``: only ``robot`` can drag the object, into its own reach.
                ``POKE``: ``robot`` can push it into its partner's reach, but not drag
                it into its own.
            robot: Index of the robot that uses the stick.
            partner: Index of the other robot.
            kind: Kind of the object to place.
            alone: Whether the partner must not reach the object even with the stick.
        """
        nobody, dragged = self.nobody(), OBJECT_KINDS[kind]
        receiver = robot if primitive is Primitive.HOOK else partner
        ways = [(Primitive.HOOK, robot, robot), (Primitive.POKE, robot, partner)]
        if primitive is Primitive.HOOK and not alone:
            ways += [(Primitive.HOOK, partner, partner)]
            ways += [(Primitive.POKE, partner, robot)]
        ways.remove((primitive, robot, receiver))

        def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
            found = nobody.sift(kind, x, y)
            # Upper bounds by the receiver's reach, the longest drag and the stick.
            far = self.territory.reach(receiver).travel_m + MAX_DRAG_M
            found &= self.territory.distance(receiver, x, y) < far
            far = self.territory.reach(robot).grasp_m + HANDLE_LENGTH_M - MIN_DRAG_M
            found &= self.territory.distance(robot, x, y) < far
            if alone:
                found &= self.territory.cannot(partner, kind, x, y, tool=True)
            return found

        def check(pose: Pose2) -> bool:
            # Distance must exclude other drags; objects in the way do not count.
            drag = (primitive, robot, receiver, pose)
            return self.can_drag(*drag, self.discs(), dragged) and not any(
                self.can_drag(*way, pose, self._bases(), dragged) for way in ways
            )

        self._drags.append((primitive, robot, receiver, len(self.objects)))
        helps = f"drag it home to the {{{robot}}}"
        if primitive is Primitive.POKE:
            helps = f"push it to the {{{partner}}}"
        says = f"where no robot could touch it, and the stick helps to {helps} alone"
        return Zone(sift, check, (partner,) if alone else (), tool=alone, says=says)

    def can_drag(
        self,
        primitive: Primitive,
        robot: int,
        receiver: int,
        pose: Pose2,
        obstacles: list[Disc],
        kind: ObjectKind,
    ) -> bool:
        """Return whether a robot can drag an object into a receiver's reach."""
        by, to = self.robots[robot], self.robots[receiver]
        return (
            find_drag(primitive, by, to, pose, obstacles, kind, self.gap_m) is not None
        )

    def check(self, goal: Goal) -> None:
        """Check conditions that depend on all placed objects.

        Raises:
            PlacementError: An object blocks a needed drag; or one robot could reach the
                goal alone by pushing towers of cubes; or a larger team could reach it
                without one of its robots.
        """
        for primitive, robot, receiver, which in self._drags:
            cube = self.objects[which]
            others, kind = self.discs(but=cube.name), cube.entity.kind
            drag = (primitive, robot, receiver)
            if not self.can_drag(*drag, cube.pose, others, kind):
                raise PlacementError(f"{primitive} {cube.name}")
        team = range(len(self.robots))
        excluded = goal.rule is not None and goal.rule.robot is not None
        there = needed(self.territory, self.objects, goal)
        joint = len(team) > 2 or any(
            kind_of(on.top).handles is not None for on in goal.placements
        )
        if joint and len(there) < len(team) - excluded:
            raise PlacementError("team without one robot")
        for robot in team:
            if self._could_push_towers(robot, goal):
                raise PlacementError(f"robot {robot} and a tower")

    def _could_push_towers(self, robot: int, goal: Goal) -> bool:
        """Return whether one robot might reach a goal by pushing towers of cubes."""
        named = {placed.name: placed for placed in self.objects}
        placements = goal.placements
        barred = [on for on in placements if robot in self._zones[on.bottom].barred]
        tool = any(self._zones[on.bottom].tool for on in barred)
        # Objects cannot be dragged across a gap.
        fetches = tool and self.gap_m is None

        def could_get(placed: ObjectPlacement) -> bool:
            kind, at = placed.entity.kind, placed.pose
            x, y = np.array([at.x]), np.array([at.y])
            return not self.territory.cannot(robot, kind, x, y, tool=fetches)[0]

        if not barred or not all(could_get(named[on.top]) for on in placements):
            return False
        for on in barred:
            spare = [
                placed.entity.kind.side_m
                for placed in self.objects
                if placed.entity.kind.cargo
                and placed.name not in (on.top, on.bottom)
                and could_get(placed)
            ]
            row_m = 2.0 * ordered_sum(spare) + named[on.top].entity.kind.side_m
            if not spare or self.territory.keeps_off(
                robot, named[on.bottom], row_m, tool=self._zones[on.bottom].tool
            ):
                return False
        return True

    def discs(self, but: str = "") -> list[Disc]:
        """Return discs of bases and objects, except the stick and ``but``."""
        found = self._bases()
        for placed in self.objects:
            if not placed.entity.kind.tool and placed.name != but:
                found.append((placed.pose.x, placed.pose.y, placed.entity.kind.disc_m))
        return found

    def _bases(self) -> list[Disc]:
        return [(r.base.x, r.base.y, sweep_radius_m(r.arm)) for r in self.robots]

    def _find(self, kind: ObjectKind, zone: Zone) -> Pose2:
        """Find a pose for an object in a zone; see :meth:`_search`."""

        def suits(x: FloatArray, y: FloatArray, yaw: FloatArray) -> Mask:
            on_table = self.territory.on_table(x, y, kind.disc_m + FROM_EDGE_M)
            return on_table & self.territory.in_view(x, y) & zone.sift(kind, x, y)

        return self._search(kind, suits, zone.check)

    def _search(
        self,
        kind: ObjectKind,
        suits: Callable[[FloatArray, FloatArray, FloatArray], Mask],
        check: Callable[[Pose2], bool] | None,
    ) -> Pose2:
        """Find a pose for an object with clearance to robots and objects.

        Args:
            kind: Kind of the object.
            suits: Returns which poses, given as arrays x, y [m] and yaw [rad], are
                candidates.
            check: Returns whether one candidate is valid; None if all are.

        Raises:
            PlacementError: No pose was found.
        """
        half = (TABLE_HALF_X_M, TABLE_HALF_Y_M, math.pi)
        for _ in range(_ROUNDS):
            x, y, yaw = (self.rng.uniform(-h, h, _DRAWS) for h in half)
            for i in np.flatnonzero(suits(x, y, yaw))[:_CHECKS]:
                # Rounding may pass a bound of ``suits``; its margins are 200 times as
                # wide, and another pose would change instances.
                pose = Pose2(float(x[i]), float(y[i]), float(yaw[i])).rounded()
                if self._is_clear(kind, pose) and (check is None or check(pose)):
                    return pose
        raise PlacementError(kind.name)

    def _is_clear(self, kind: ObjectKind, pose: Pose2) -> bool:
        """Return whether an object would have clearance to robots and objects."""
        return all(
            gap_m(kind, pose, None, robot.base)
            >= sweep_radius_m(robot.arm) + beside_base_m(kind)
            for robot in self.robots
        ) and all(
            gap_m(kind, pose, placed.entity.kind, placed.pose)
            >= kind.spacing_to(placed.entity.kind)
            for placed in self.objects
        )
