"""Kinds of objects: shapes and affordances.

One record has all properties of a kind: geoms for physics, the grasp for skills, the
support surface for goals, clearances for the planner, nouns for language. It does not
need MuJoCo, so that code without a simulator (policies, servers) can use it.

:func:`box` and :func:`cylinder` create common kinds from their sizes.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.core.registry import Registry
from lemma.robots.gripper import FINGER_OPENING_M, PALM_ABOVE_TCP_M
from lemma.scene.objects.palette import Rgba

if TYPE_CHECKING:
    import mujoco

Point = tuple[float, float, float]

SHAPES = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1}
"""Shapes of parts, with the number of sizes of each."""

_NAME = re.compile(r"[a-z][a-z0-9]*")
_RESERVED = ("shared", "table", "start", "hand")
"""Names of supports and regions that are not objects."""
_FINGERS_BETWEEN_M = 0.055
"""Default gap between the discs of two objects, so that fingers fit between them."""
_CLEAR_OF_PALM_M = 0.004
_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Part:
    """One rigid piece of an object, a geom."""

    shape: str
    """A name in :data:`SHAPES`."""
    size_m: tuple[float, ...]
    """Sizes as in MuJoCo [m]: three half extents of a box; radius and half length along
    z of a cylinder or capsule; radius of a sphere."""
    mass_kg: float | None = None
    """Mass; None for a part of an object that is fixed to the table."""
    position_m: Point = (0.0, 0.0, 0.0)
    """Centre of the part in the object's frame [m]."""
    name: str = ""
    """Name of the part, unique within its object."""

    def __post_init__(self) -> None:
        """Check the shape and its sizes.

        Raises:
            InvalidConfigError: No such shape, or the wrong number of sizes, or a size
                that is not positive.
        """
        fits = len(self.size_m) == SHAPES.get(self.shape)
        if not fits or not all(0.0 < size < math.inf for size in self.size_m):
            shapes = ", ".join(f"{name} ({count})" for name, count in SHAPES.items())
            raise InvalidConfigError(
                f"A part cannot be a {self.shape!r} of sizes {self.size_m}. Valid "
                f"shapes, and how many positive sizes [m] each has: {shapes}."
            )


@dataclass(frozen=True, slots=True)
class Capsule:
    """A capsule in an object's frame, an obstacle for arms."""

    start: Point
    end: Point
    radius_m: float


@dataclass(frozen=True, slots=True)
class Shell:
    """Obstacle for the safety filter of control-level actions."""

    capsules: tuple[Capsule, ...]
    """Capsules that cover the object at any heading; the inner edges of the stick's
    hook protrude by 9.6 mm at most."""
    rim_m: float
    """Height of the object's top above the higher end of the first capsule's axis [m].
    """


@dataclass(frozen=True, slots=True)
class Grasp:
    """The grasp of an upright object by a gripper that points down."""

    width_m: float
    """Opening of the fingers that hold the object [m]."""
    height_m: float
    """Height of the tool centre point above the object's support [m]."""
    turn_rad: float
    """Symmetry: the grasp may be rotated by multiples of this angle about the vertical
    [rad]; 0 for round objects, which can be grasped from any side."""
    at: Pose2 = field(default_factory=lambda: Pose2(0.0, 0.0))
    """Pose of the gripper in the object's frame."""


@dataclass(frozen=True, slots=True)
class Carried:
    """How two grippers that point down carry an object at once, one at either end."""

    handles: tuple[Grasp, Grasp]
    """How each holds it."""
    rest_m: float
    """From its middle to where it rests on what it is put on, to both sides along x
    [m]."""


Builder = Callable[["mujoco.MjSpec", "mujoco.MjsBody", str], None]
"""Adds elements other than parts to an object's body. Its arguments are the MuJoCo
specification of the scene, the body, and the object's name; all names that it adds must
begin with that name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectKind:
    """A kind of object. Lengths are in metres, in the frame of the object's body.

    The frame has z up and x along the object's heading.

    Raises:
        InvalidConfigError: The name or a noun is invalid, a length is not positive, or
            the grasp is not feasible.
    """

    name: str
    """Name of the kind, which follows a color in names of entities, such as ``"cube"``:
    lower-case letters and digits."""
    nouns: tuple[str, ...] = ()
    """Words for it; instructions use the first. If empty, the name."""
    parts: tuple[Part, ...]
    """Its geoms."""
    build: Builder | None = None
    """Adds elements other than parts, such as meshes."""
    color: Rgba | None = None
    """Color of a kind with at most one object in a scene, which has the kind's name;
    None if the kind comes in all colors of the palette."""
    listed: bool = True
    """Whether actions and observations of all tasks have a number for it; otherwise
    only those of tasks that have it in :attr:`.Task.kinds`."""
    fixed: bool = False
    """Whether objects are fixed to the table."""
    tool: bool = False
    """Whether it is a tool, which acts on other objects and is never part of a goal."""
    height_m: float
    """Height of its top above its support."""
    origin_m: float
    """Height of its frame above its support."""
    disc_m: float
    """Radius of a disc around its centre that covers it, seen from above; for the
    stick, around any point of its axes."""
    side_m: float
    """Mean distance from its centre to its sides, beside which fingers descend."""
    spacing_m: Mapping[str, float] = field(default_factory=dict)
    """Smallest initial distance of its centre from the centre of objects of other
    kinds, or from the axes of the stick, by name of the kind. The default of a pair is
    the sum of both discs with room for fingers."""
    grasp: Grasp | None = None
    """The grasp; None if no gripper can hold it."""
    carried: Carried | None = None
    """How two robots carry it together; None for other kinds."""
    ends: tuple[Grasp, Grasp] | None = None
    """How a hand holds it near either end, as one robot hands it to another; None for
    other kinds."""
    tops: tuple[Point, ...] = (_UP,)
    """Unit vectors in its frame that may point up when it stands on a face: six for a
    box, two for a cylinder."""
    support_m: float | None = None
    """Largest distance between its centre and the centre of an object on it; None if no
    object can lie on it."""
    span_m: float | None = None
    """Distance between the centres of the two objects of equal height that it lies on,
    one at each side of its centre along x; None for a kind that lies on one object."""
    drag_m: float | None = None
    """Distance from its centre to the contact point of the stick; None if the stick
    cannot drag it."""
    obstacle: tuple[Capsule, ...]
    """Obstacles for arms under RMPflow."""
    shell: Shell
    """Obstacles for the safety filter."""

    def __post_init__(self) -> None:
        """Check all properties.

        Raises:
            InvalidConfigError: The name or a noun is invalid, a length is not positive,
                or the grasp is not feasible.
        """
        if not _NAME.fullmatch(self.name) or self.name in _RESERVED:
            raise self._error(
                "its name must be lower-case letters and digits alone, and none of "
                f"{', '.join(_RESERVED)}"
            )
        if not self.nouns:
            object.__setattr__(self, "nouns", (self.name,))
        for noun in self.nouns:
            if not re.fullmatch(r"[a-z]+(?:[ '-][a-z]+)*", noun):
                raise self._error(
                    f"{noun!r} is no noun; write lower-case English words"
                )
        for what in ("height_m", "disc_m", "side_m"):
            if not 0.0 < getattr(self, what) < math.inf:
                raise self._error(f"{what}={getattr(self, what)} must be positive")
        weightless = any(not part.mass_kg for part in self.parts)
        if weightless and not self.fixed:
            raise self._error("a movable kind needs the mass of each of its parts")
        if self.grasp is not None:
            self._check_grasp(self.grasp)

    def _check_grasp(self, grasp: Grasp) -> None:
        if self.fixed:
            raise self._error("a kind that is fixed to the table has no grasp")
        if not self.tool and grasp.at.xy != (0.0, 0.0):
            raise self._error("only a tool can be grasped beside its middle")
        if not 0.0 < grasp.width_m < FINGER_OPENING_M:
            raise self._error(
                f"it is held at a width of {grasp.width_m:g} m, but the fingers open "
                f"to {FINGER_OPENING_M:g} m. Make it narrower, or set grasp=None"
            )
        if not 0.0 < grasp.height_m >= self.height_m - PALM_ABOVE_TCP_M:
            raise self._error(
                f"grasped {grasp.height_m:g} m above its bottom it would touch the "
                f"palm, which is {PALM_ABOVE_TCP_M:g} m above the fingers' middle. "
                "Grasp it higher"
            )

    def _error(self, reason: str) -> InvalidConfigError:
        return InvalidConfigError(f"Object kind {self.name!r}: {reason}.")

    @property
    def handles(self) -> tuple[Grasp, Grasp] | None:
        """How two hands hold it, one near either end; None for other kinds."""
        return self.ends if self.carried is None else self.carried.handles

    @property
    def colored(self) -> bool:
        """Whether it comes in all colors of the palette."""
        return self.color is None

    @property
    def cargo(self) -> bool:
        """Whether goals may move it: it is neither fixed nor a tool."""
        return not (self.fixed or self.tool)

    @property
    def faceted(self) -> bool:
        """Whether it is grasped along its faces; objects in stacks are then aligned."""
        return self.grasp is not None and self.grasp.turn_rad > 0.0

    @property
    def top_m(self) -> float:
        """Height of its top above its frame [m]."""
        return self.height_m - self.origin_m

    def rests(self, pose: Pose2) -> tuple[Pose2, ...]:
        """Return over which places its weight rests: its middle, or two of a plank.

        Args:
            pose: Where it lies.
        """
        if self.span_m is None:
            return (pose,)
        half_m = 0.5 * self.span_m
        return (pose @ Pose2(-half_m, 0.0), pose @ Pose2(half_m, 0.0))

    def spacing_to(self, other: "ObjectKind") -> float:
        """Return the smallest initial distance of the centres of two objects [m]."""
        for one, two in ((self, other), (other, self)):
            if two.name in one.spacing_m:
                return one.spacing_m[two.name]
        return self.disc_m + other.disc_m + _FINGERS_BETWEEN_M


OBJECT_KINDS: Registry[ObjectKind] = Registry("object kind", ObjectKind)
"""All kinds of objects, by name; built-in ones first."""


def box(name: str, size_m: Point, mass_kg: float, **details: Any) -> ObjectKind:
    """Return the kind of a solid box that can be grasped and stacked.

    Args:
        name: Name of the kind.
        size_m: Edge lengths along x, y and z [m].
        mass_kg: Mass [kg].
        **details: Fields of :class:`ObjectKind` that replace the computed ones, such as
            ``grasp=None`` or ``drag_m=0.03``.

    Raises:
        InvalidConfigError: No gripper can hold it, or a field is invalid.
    """
    x, y, z = size_m
    half = (x / 2, y / 2, z / 2)
    diagonal = math.hypot(half[0], half[1])
    square = x == y
    # The fingers close along the gripper's y axis, across the narrower side.
    across = 0.0 if y <= x else math.pi / 2
    return replace(
        _upright(name, z, (Part("box", half, mass_kg),), diagonal, max(half[:2])),
        **{
            "grasp": Grasp(
                min(x, y),
                _grasp_height_m(z),
                math.pi / 2 if square else math.pi,
                Pose2(0.0, 0.0, across),
            ),
            "tops": tuple(
                (i * sign, j * sign, k * sign)
                for i, j, k in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), _UP)
                for sign in (1.0, -1.0)
            ),
            "support_m": min(half[:2]),
            **details,
        },
    )


def cylinder(
    name: str, radius_m: float, height_m: float, mass_kg: float, **details: Any
) -> ObjectKind:
    """Return the kind of a solid upright cylinder that can be grasped and stacked.

    Args:
        name: Name of the kind.
        radius_m: Radius [m].
        height_m: Height [m].
        mass_kg: Mass [kg].
        **details: Fields of :class:`ObjectKind` that replace the computed ones, such as
            ``nouns=("can", "tin")`` or ``drag_m=radius_m``.

    Raises:
        InvalidConfigError: No gripper can hold it, or a field is invalid.
    """
    parts = (Part("cylinder", (radius_m, height_m / 2), mass_kg),)
    return replace(
        _upright(name, height_m, parts, radius_m, radius_m),
        **{
            "grasp": Grasp(2 * radius_m, _grasp_height_m(height_m), 0.0),
            "tops": (_UP, (0.0, 0.0, -1.0)),
            "support_m": radius_m,
            **details,
        },
    )


def _upright(
    name: str, height_m: float, parts: tuple[Part, ...], disc_m: float, side_m: float
) -> ObjectKind:
    """Return a kind that stands upright, with its frame at its centre."""
    half = height_m / 2
    inner = max(0.0, half - side_m)
    column = Capsule((0.0, 0.0, -inner), (0.0, 0.0, inner), side_m)
    around = Capsule((0.0, 0.0, -half), (0.0, 0.0, half), disc_m)
    return ObjectKind(
        name=name,
        parts=parts,
        height_m=height_m,
        origin_m=half,
        disc_m=disc_m,
        side_m=side_m,
        obstacle=(column,),
        shell=Shell((around,), 0.0),
    )


def _grasp_height_m(height_m: float) -> float:
    """Return the grasp height [m]: the centre, or higher if the palm would collide."""
    return max(height_m / 2, height_m - PALM_ABOVE_TCP_M + _CLEAR_OF_PALM_M)
