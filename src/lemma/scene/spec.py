"""Specification of a scene: frozen data, no physics."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from lemma.core.arguments import known, real
from lemma.core.errors import InvalidConfigError, UnknownNameError, shown
from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_names
from lemma.robots.ur.arms import ARMS
from lemma.scene.objects.entity import Entity
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.table import TABLE_HALF_X_M, Gap

ROBOT_COLORS = ("red", "white", "blue", "green")
PAIR_COLORS = ROBOT_COLORS[:2]
"""The colors of robots in teams of two."""
_LEAST_TOP_M = 0.3
"""Smallest width of a table top."""
ROOM_M = 10.0
"""Largest absolute x and y of robots and objects [m]."""


@dataclass(frozen=True, slots=True)
class RobotPlacement:
    """One robot: arm type, color and base.

    Raises:
        UnknownNameError: No such arm or color.
        InvalidConfigError: The base is not a pose in the room.
    """

    arm: str
    """Arm type, a name in ``lemma.robots.ur.build.ARMS``."""
    color: str
    """One of :data:`ROBOT_COLORS`."""
    base: Pose2
    """World from base; the base's x axis is the robot's front."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        ARMS[self.arm]
        known("robot color", self.color, ROBOT_COLORS)
        _check_pose(f"base of the {self.arm}", self.base)


@dataclass(frozen=True, slots=True)
class ObjectPlacement:
    """One object: kind, color and pose.

    Raises:
        UnknownNameError: No such kind or color.
        InvalidConfigError: The pose is not in the room.
    """

    kind: str
    """A name in ``lemma.scene.objects.kind.OBJECT_KINDS``, such as ``"cube"``."""
    color: str
    """A name in ``lemma.scene.objects.palette.OBJECT_COLORS``; any word for a kind with
    a color of its own, such as ``"yellow"`` for the stick."""
    pose: Pose2
    """World from object; the object lies on the table."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        if OBJECT_KINDS[self.kind].colored:
            OBJECT_COLORS[self.color]
        _check_pose(f"pose of the {self.name}", self.pose)

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
    def regions(self) -> Mapping[str, tuple[int, ...]]:
        """Names of regions, with the indices of their robots.

        ``{"shared": (0, 1)}`` for two robots; see :mod:`lemma.scene.regions`.
        """
        # Late import: reach needs Numba kernels, which policy servers may lack.
        from lemma.scene.regions import regions_of  # noqa: PLC0415

        return regions_of(tuple((r.arm, r.base) for r in self.robots), self.gap_m)

    def placement(self, name: str) -> ObjectPlacement:
        """Return the object called ``name``.

        Raises:
            UnknownNameError: There is no such object in this scene.
        """
        for placed in self.objects:
            if placed.name == name:
                return placed
        raise UnknownNameError("object in this scene", name, self.object_names)


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
