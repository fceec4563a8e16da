"""A table being set: where things may go, by who shall reach them.

A task says what it needs ("a cube that only this robot reaches"); the board finds a
place by rejection sampling, as in the paper, and remembers what is there. When no place
is found, the whole attempt is given up and a new one begins.
"""

import math
from collections.abc import Callable

import numpy as np

from lemma.core.errors import InvalidConfigError, SamplingError
from lemma.core.poses import Pose2
from lemma.robots.collision_model import sweep_radius_m
from lemma.robots.reach import Reach, reach_of
from lemma.scene.build import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.scene.camera_mounts import camera_sees
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_KIND,
)
from lemma.scene.palette import BENCHMARK_COLORS
from lemma.scene.spec import ObjectPlacement, RobotPlacement
from lemma.tasks.drags import (
    LARGEST_HEADING_RAD,
    Disc,
    find_drag,
    grasp_on_stick,
    heading_from,
    stick_gap,
)
from lemma.tasks.subtask import Primitive

INSIDE_M = 0.03
"""How far inside its reach a robot's objects are, at least."""
OUTSIDE_M = 0.025
"""How far out of its grasp the others' objects are, at least."""

_TRIES = 400
_EDGE_M = 0.10
_FACING_RAD = math.radians(65.0)
"""Objects lie in front of their robot: at its sides the waiting arm hides them."""
_BESIDE_BASE_M = 0.06

_KINDS = ("cube", "pad")
"""Kinds whose colors are shuffled first of all, in the benchmark's order."""

Zone = Callable[[Pose2], bool]
"""Whether something may lie at a pose."""


class PlacementError(Exception):
    """This attempt at setting the table failed; another one may succeed."""


class Board:
    """The table while an instance is being sampled."""

    def __init__(
        self, robots: tuple[RobotPlacement, ...], rng: np.random.Generator
    ) -> None:
        """Begin with the robots and nothing else.

        Args:
            robots: The team.
            rng: Where every draw comes from.
        """
        self.robots = robots
        self.rng = rng
        self.objects: list[ObjectPlacement] = []
        self._free = {kind: self._shuffled() for kind in _KINDS}
        self._drags: list[tuple[Primitive, int, int, int]] = []
        order = rng.permutation(len(robots))
        self.order: tuple[int, ...] = tuple(int(i) for i in order)
        """The robots in random order: who plays which role."""

    def reach(self, robot: int) -> Reach:
        """Return the reach of a robot."""
        return reach_of(self.robots[robot].arm)

    def cube(self, zone: Zone, color: str | None = None) -> str:
        """Put a cube into a zone; see :meth:`put`."""
        return self.put("cube", zone, color)

    def pad(self, zone: Zone, color: str | None = None) -> str:
        """Put a pad into a zone; see :meth:`put`."""
        return self.put("pad", zone, color)

    def put(self, kind: str, zone: Zone, color: str | None = None) -> str:
        """Put an object into a zone.

        Args:
            kind: A name in :data:`~lemma.scene.objects.kind.OBJECT_KINDS`.
            zone: Where it may lie.
            color: Its color; one of the benchmark's that the kind has not used yet if
                None. Colors that were registered are put only where they are named.

        Returns:
            The entity's name.

        Raises:
            UnknownNameError: No such kind or color.
            SamplingError: The kind has no such color left.
            PlacementError: No place was found.
        """
        record = OBJECT_KINDS[kind]
        if record.tool:
            raise InvalidConfigError(f"A {kind} is put with Board.{kind}(robot).")
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
        for _ in range(_TRIES):
            pose = self._draw()
            if self._faces(pose) and self._fits(record, pose) and zone(pose):
                chosen = color or free[0]
                if chosen in free:
                    free.remove(chosen)
                placed = ObjectPlacement(kind, chosen, pose)
                self.objects.append(placed)
                return placed.name
        raise PlacementError(kind)

    def has_colors(self, kind: str) -> bool:
        """Whether another cube or pad of a new color can be put."""
        return bool(self._free[kind])

    def _shuffled(self) -> list[str]:
        return [str(color) for color in self.rng.permutation(list(BENCHMARK_COLORS))]

    def stick(self, robot: int) -> str:
        """Put the stick where one robot alone can pick it up and swing it out."""
        only = self.only(robot)
        base = self.robots[robot].base
        for _ in range(_TRIES):
            pose = self._draw()
            if heading_from(base, pose) > LARGEST_HEADING_RAD:
                continue
            grasp = grasp_on_stick(pose)
            if only(grasp) and self._faces(grasp) and self._stick_fits(pose):
                placed = ObjectPlacement("stick", "yellow", pose)
                self.objects.append(placed)
                return placed.name
        raise PlacementError("stick")

    def only(self, robot: int) -> Zone:
        """Where one robot reaches and no other can."""

        def zone(pose: Pose2) -> bool:
            return self.reaches(robot, pose) and all(
                self.cannot(other, pose)
                for other in range(len(self.robots))
                if other != robot
            )

        return zone

    def nobody(self) -> Zone:
        """Where no robot can grasp anything."""
        return lambda pose: all(self.cannot(r, pose) for r in range(len(self.robots)))

    def anywhere(self) -> Zone:
        """Where each robot either surely reaches or surely does not."""
        return lambda pose: all(
            self.reaches(r, pose) or self.cannot(r, pose)
            for r in range(len(self.robots))
        )

    def tool_only(
        self, primitive: Primitive, robot: int, partner: int, kind: str = "cube"
    ) -> Zone:
        """Where nobody reaches, and the stick helps in exactly one way.

        Args:
            primitive: ``HOOK``: ``robot`` can drag the cube into its own reach, and
                there is no other way. ``POKE``: it can push it into its partner's
                reach, and not drag it into its own.
            robot: Who uses the stick.
            partner: The other robot.
            kind: What will be put there.
        """
        nobody, dragged = self.nobody(), OBJECT_KINDS[kind]
        receiver = robot if primitive is Primitive.HOOK else partner
        ways = [(Primitive.HOOK, robot, robot), (Primitive.POKE, robot, partner)]
        if primitive is Primitive.HOOK:
            ways += [(Primitive.HOOK, partner, partner)]
            ways += [(Primitive.POKE, partner, robot)]
        ways.remove((primitive, robot, receiver))

        def zone(pose: Pose2) -> bool:
            # Other ways must be closed by distance, not by what happens to be around.
            return (
                nobody(pose)
                and self.can_drag(
                    primitive, robot, receiver, pose, self.discs(), dragged
                )
                and not any(
                    self.can_drag(*way, pose, self._bases(), dragged) for way in ways
                )
            )

        self._drags.append((primitive, robot, receiver, len(self.objects)))
        return zone

    def can_drag(
        self,
        primitive: Primitive,
        robot: int,
        receiver: int,
        pose: Pose2,
        obstacles: list[Disc],
        kind: ObjectKind = CUBE,
    ) -> bool:
        """Whether a robot with the stick brings a cube into a robot's own reach."""
        base, reach = self.robots[receiver].base, self.reach(receiver)
        drag = find_drag(
            primitive,
            self.robots[robot],
            pose,
            lambda x, y: reach.margin(base, x, y),
            obstacles,
            kind,
        )
        return drag is not None

    def check(self) -> None:
        """Check that what was put later left every needed drag possible.

        Raises:
            PlacementError: Something is in the way.
        """
        for primitive, robot, receiver, which in self._drags:
            cube = self.objects[which]
            others, kind = self.discs(but=cube.name), cube.entity.kind
            if not self.can_drag(primitive, robot, receiver, cube.pose, others, kind):
                raise PlacementError(f"{primitive} {cube.name}")

    def discs(self, but: str = "") -> list[Disc]:
        """Return what lies on the table and the bases, without the stick, as discs."""
        found = self._bases()
        for placed in self.objects:
            if not placed.entity.kind.tool and placed.name != but:
                disc = (placed.pose.x, placed.pose.y, placed.entity.kind.disc_m)
                found.append(disc)
        return found

    def _bases(self) -> list[Disc]:
        return [(r.base.x, r.base.y, sweep_radius_m(r.arm)) for r in self.robots]

    def reaches(self, robot: int, pose: Pose2) -> bool:
        """Whether a position is surely in a robot's reach."""
        base = self.robots[robot].base
        return self.reach(robot).margin(base, pose.x, pose.y) >= INSIDE_M

    def cannot(self, robot: int, pose: Pose2) -> bool:
        """Whether a position is surely out of a robot's grasp."""
        base = self.robots[robot].base
        return self.reach(robot).excess(base, pose.x, pose.y) >= OUTSIDE_M

    def _draw(self) -> Pose2:
        x = self.rng.uniform(_EDGE_M - TABLE_HALF_X_M, TABLE_HALF_X_M - _EDGE_M)
        y = self.rng.uniform(_EDGE_M - TABLE_HALF_Y_M, TABLE_HALF_Y_M - _EDGE_M)
        return Pose2(x, y, self.rng.uniform(-math.pi, math.pi)).rounded()

    def _faces(self, pose: Pose2) -> bool:
        """Whether some robot has the position in front of it and its camera sees it."""
        for robot in self.robots:
            local = robot.base.inverse() @ pose
            bearing = math.atan2(local.y, local.x)
            if abs(bearing) <= _FACING_RAD and camera_sees(robot, pose.x, pose.y):
                return True
        return False

    def _fits(self, kind: ObjectKind, pose: Pose2) -> bool:
        for robot in self.robots:
            if robot.base.distance(pose) < sweep_radius_m(robot.arm) + _BESIDE_BASE_M:
                return False
        for placed in self.objects:
            other = placed.entity.kind
            gap = (
                stick_gap(placed.pose, pose.x, pose.y)
                if other.tool
                else placed.pose.distance(pose)
            )
            if gap < kind.spacing_to(other):
                return False
        return True

    def _stick_fits(self, pose: Pose2) -> bool:
        """Whether the whole stick lies on the table, clear of everything."""
        corner = pose @ Pose2(HANDLE_LENGTH_M, HOOK_LENGTH_M)
        tip = pose @ Pose2(HANDLE_LENGTH_M, 0.0)
        for end in (corner, tip, pose):
            inside_x = abs(end.x) < TABLE_HALF_X_M - 0.05
            if not (inside_x and abs(end.y) < TABLE_HALF_Y_M - 0.05):
                return False
        for robot in self.robots:
            gap = stick_gap(pose, robot.base.x, robot.base.y)
            if gap < sweep_radius_m(robot.arm) + _BESIDE_BASE_M:
                return False
        return all(
            stick_gap(pose, placed.pose.x, placed.pose.y)
            >= placed.entity.kind.spacing_to(STICK_KIND)
            for placed in self.objects
        )
