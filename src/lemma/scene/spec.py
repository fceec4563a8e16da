"""Specification of a scene: frozen data, no physics."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from lemma.core.arguments import known, real
from lemma.core.errors import InvalidConfigError, UnknownNameError, shown
from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_names
from lemma.core.seeding import ordered_sum
from lemma.robots.hand import HANDS, STANDARD, carries_kg
from lemma.robots.ur.arms import ARMS
from lemma.scene.objects.entity import Entity
from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.table import TABLE_HALF_X_M, Gap

ROBOT_COLORS = ("red", "white", "blue", "green")
PAIR_COLORS = ROBOT_COLORS[:2]
"""The colors of robots in teams of two."""
_LEAST_TOP_M = 0.3
"""Smallest width of a table top."""
_LEAST_KG, _MOST_KG = 0.01, 100.0
ROOM_M = 10.0
"""Largest absolute x and y of robots and objects [m]."""


@dataclass(frozen=True, slots=True)
class RobotPlacement:
    """One robot: arm type, color, base and hand.

    Raises:
        UnknownNameError: No such arm, hand or color.
        InvalidConfigError: The base is not a pose in the room.
    """

    arm: str
    """Arm type, a name in ``lemma.robots.ur.build.ARMS``."""
    color: str
    """One of :data:`ROBOT_COLORS`."""
    base: Pose2
    """World from base; the base's x axis is the robot's front."""
    hand: str = STANDARD
    """A name in ``lemma.robots.hand.HANDS``."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        ARMS[self.arm]
        HANDS[self.hand]
        known("robot color", self.color, ROBOT_COLORS)
        _check_pose(f"base of the {self.arm}", self.base)

    @property
    def carries_kg(self) -> float:
        """Largest mass that it may carry, for its hand and its arm [kg]."""
        return carries_kg(self.arm, self.hand)

    def overload(self, name: str, thing: "ObjectPlacement") -> str:
        """Return why an object is too heavy for it; empty if it is not.

        Args:
            name: Its name.
            thing: The object.
        """
        if thing.weight_kg <= self.carries_kg:
            return ""
        return (
            f"The {thing.name} weighs {thing.weight_kg:g} kg, but {name} ({self.arm}, "
            f"{self.hand} hand) carries {self.carries_kg:.2g} kg."
        )


@dataclass(frozen=True, slots=True)
class ObjectPlacement:
    """One object: kind, color, pose and mass.

    Raises:
        UnknownNameError: No such kind or color.
        InvalidConfigError: The pose is not in the room, or it cannot have such a mass.
    """

    kind: str
    """A name in ``lemma.scene.objects.kind.OBJECT_KINDS``, such as ``"cube"``."""
    color: str
    """A name in ``lemma.scene.objects.palette.OBJECT_COLORS``; any word for a kind with
    a color of its own, such as ``"yellow"`` for the stick."""
    pose: Pose2
    """World from object; the object lies on the table."""
    mass_kg: float | None = None
    """Mass [kg]; None if it is that of the kind. Only a box of one part may have
    another one."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        if OBJECT_KINDS[self.kind].colored:
            OBJECT_COLORS[self.color]
        _check_pose(f"pose of the {self.name}", self.pose)
        if self.mass_kg is not None:
            _check_mass(self.name, OBJECT_KINDS[self.kind], self.mass_kg)

    @property
    def weight_kg(self) -> float:
        """Its mass, be it its own or its kind's [kg]; 0 for what is fixed."""
        if self.mass_kg is not None:
            return self.mass_kg
        parts = OBJECT_KINDS[self.kind].parts
        return ordered_sum(part.mass_kg or 0.0 for part in parts)

    @property
    def entity(self) -> Entity:
        """The entity of color and kind."""
        kind = OBJECT_KINDS[self.kind]
        return Entity(self.color if kind.colored else "", kind)

    @property
    def name(self) -> str:
        """Entity name, such as ``"red_cube"`` or ``"stick"``."""
        return self.entity.name


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """Specification of a scene: robots, objects and table.

    Raises:
        InvalidConfigError: An entity occurs twice, a field has a wrong type, or the gap
            leaves no table beside it.
    """

    robots: tuple[RobotPlacement, ...]
    objects: tuple[ObjectPlacement, ...]
    gap_m: Gap | None = None
    """Gap in the table, x from and to [m]; None without a gap."""

    def __post_init__(self) -> None:
        """Check types, unique names and the gap."""
        if self.gap_m is not None:
            _check_gap(self.gap_m)
        for placed, wanted in (
            (self.robots, RobotPlacement),
            (self.objects, ObjectPlacement),
        ):
            if not isinstance(placed, tuple) or not all(
                isinstance(one, wanted) for one in placed
            ):
                raise InvalidConfigError(
                    f"{shown(placed)} cannot be part of a scene. Valid: a tuple of "
                    f"{wanted.__name__}."
                )
        names = [placed.name for placed in self.objects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidConfigError(
                f"Objects named twice in one scene: {', '.join(twice)}. Each kind and "
                "color may occur once; choose another color."
            )

    @property
    def robot_names(self) -> tuple[str, ...]:
        """Names of the robots: ``("robot_0", "robot_1", ...)``."""
        return robot_names(len(self.robots))

    @property
    def object_names(self) -> tuple[str, ...]:
        """Entity names in the order of ``objects``."""
        return tuple(placed.name for placed in self.objects)

    @property
    def other_hands(self) -> tuple[str, ...]:
        """The robots' hands by name; empty where all have the standard one."""
        hands = tuple(robot.hand for robot in self.robots)
        return hands if set(hands) - {STANDARD} else ()

    @property
    def regions(self) -> Mapping[str, tuple[int, ...]]:
        """Names of regions, with the indices of their robots.

        ``{"shared": (0, 1)}`` for two robots; see :mod:`lemma.scene.regions`.
        """
        # Late import: reach needs Numba kernels, which policy servers may lack.
        from lemma.scene.regions import regions_of  # noqa: PLC0415

        return regions_of(tuple((r.arm, r.base) for r in self.robots), self.gap_m)

    def rests_m(self, placed: ObjectPlacement) -> float:
        """Return the height of what an object lies on at the beginning [m].

        That is the table, or a tray if its middle is over the part that carries it.
        """
        return load_height_m(placed, self.objects)

    def placement(self, name: str) -> ObjectPlacement:
        """Return the object called ``name``.

        Raises:
            UnknownNameError: There is no such object in this scene.
        """
        for placed in self.objects:
            if placed.name == name:
                return placed
        raise UnknownNameError("object in this scene", name, self.object_names)


def load_height_m(placed: ObjectPlacement, objects: Iterable[ObjectPlacement]) -> float:
    """Return the height of the tray that an object begins on; 0 for the table [m].

    Args:
        placed: The object.
        objects: All objects on the table.
    """
    for other in objects:
        kind = other.entity.kind
        if kind.carried is None or not placed.entity.kind.cargo or other == placed:
            continue
        if placed.pose.distance(other.pose) < (kind.support_m or 0.0):
            return kind.height_m
    return 0.0


def _check_gap(gap: object) -> None:
    """Check that a gap leaves a table top on either side.

    Raises:
        InvalidConfigError: It does not, or is no pair of numbers.
    """
    bounds = gap if isinstance(gap, tuple) and len(gap) == 2 else (math.nan, math.nan)
    most = TABLE_HALF_X_M - _LEAST_TOP_M
    left, right = (real("end of the gap", bound, -most, most) for bound in bounds)
    if not left < right:
        raise InvalidConfigError(
            f"gap_m={shown(gap)} has no width. Valid: x from and to [m]."
        )


def _check_mass(name: str, kind: ObjectKind, mass_kg: object) -> None:
    """Check that a thing can have a mass of its own.

    Raises:
        InvalidConfigError: It cannot.
    """
    real(f"mass of the {name}", mass_kg, _LEAST_KG, _MOST_KG)
    if kind.fixed or [part.shape for part in kind.parts] != ["box"]:
        raise InvalidConfigError(
            f"The {name} cannot have a mass of its own: only a box of one part can."
        )


def _check_pose(what: str, pose: object) -> None:
    """Check that a value is a pose in the room.

    Raises:
        InvalidConfigError: It is not.
    """
    if not isinstance(pose, Pose2):
        raise InvalidConfigError(
            f"The {what} is {shown(pose)}. Valid: a Pose2, x and y in m, yaw in rad."
        )
    real(f"x in the {what}", pose.x, -ROOM_M, ROOM_M)
    real(f"y in the {what}", pose.y, -ROOM_M, ROOM_M)
    real(f"yaw in the {what}", pose.yaw)
