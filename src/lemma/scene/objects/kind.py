"""Kinds of objects: shape, and what robots can do with it.

One record answers every question that the rest asks about an object: physics what it is
made of, skills where to grasp it, goals what may lie on it, the planner how much room
it takes, language what it is called. Plain data, so that code without a simulator
(policies, servers) reads the same numbers.

:func:`box` and :func:`cylinder` make the usual kinds from their sizes alone.
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
"""Shapes of parts, and how many sizes each has."""

_NAME = re.compile(r"[a-z][a-z0-9]*")
_RESERVED = ("shared", "table", "start", "hand")
"""Other things that an object may lie on or be put to."""
_FINGERS_BETWEEN_M = 0.055
"""Between the discs of two objects that lie beside each other: fingers fit between."""
_CLEAR_OF_PALM_M = 0.004
_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Part:
    """One rigid piece of an object, a geom."""

    shape: str
    """A name in :data:`SHAPES`."""
    size_m: tuple[float, ...]
    """As MuJoCo has it: a box's three half extents; a cylinder's or capsule's radius
    and half length along z; a sphere's radius [m]."""
    mass_kg: float | None = None
    """None for a part of what is fixed to the table."""
    position_m: Point = (0.0, 0.0, 0.0)
    """Middle of the part in the object's frame [m]."""
    name: str = ""
    """Tells the parts of one object from each other."""

    def __post_init__(self) -> None:
        """Check the shape and its sizes.

        Raises:
            InvalidConfigError: No such shape, or sizes that it does not have.
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
    """A capsule in an object's frame: its obstacle to an arm that moves by."""

    start: Point
    end: Point
    radius_m: float


@dataclass(frozen=True, slots=True)
class Shell:
    """Obstacle of the safety filter of control-level actions."""

    capsules: tuple[Capsule, ...]
    """They cover the object, at any heading; of the stick, all but the inner edges of
    its hook, which stick out by 9.6 mm at most."""
    rim_m: float
    """The object's top above the higher end of its first capsule's axis [m]."""


@dataclass(frozen=True, slots=True)
class Grasp:
    """How a gripper that points down holds an object that stands upright."""

    width_m: float
    """Opening of the fingers when they hold it [m]."""
    height_m: float
    """Tool centre point above what the object lies on [m]."""
    turn_rad: float
    """The fingers close along the object's own heading and every multiple of this
    from it [rad]; 0 for what is round and held from any side."""
    at: Pose2 = field(default_factory=lambda: Pose2(0.0, 0.0))
    """Where the gripper closes, in the object's frame."""


Builder = Callable[["mujoco.MjSpec", "mujoco.MjsBody", str], None]
"""Adds what parts cannot say to an object's body: the scene being built, the body, and
the object's name, with which every name that is given must begin."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectKind:
    """A kind of object. Lengths in metres, in the frame of the object's body.

    The frame stands upright: z up, and x where the object's heading points.
    """

    name: str
    """Nouns of the kind, which follow a color: ``"cube"``. Lower-case
    letters and digits."""
    nouns: tuple[str, ...] = ()
    """Words for it; instructions use the first. The name if empty."""
    parts: tuple[Part, ...]
    """Its geoms."""
    build: Builder | None = None
    """Adds what parts cannot say, such as meshes."""
    color: Rgba | None = None
    """Color of a kind of which there is one in a scene, called by the kind's name
    alone; None where it comes in every color of the palette."""
    listed: bool = True
    """Whether actions and observations of every task count it; otherwise only those of
    tasks that name it in :attr:`.Task.kinds`."""
    fixed: bool = False
    """Whether it is part of the table."""
    tool: bool = False
    """Whether it is there to act on others with and never a goal's."""
    height_m: float
    """Of its top above what it lies on."""
    origin_m: float
    """Of its frame above what it lies on."""
    disc_m: float
    """Radius of a disc around its middle that covers it, seen from above; of the stick,
    around any point of its axes."""
    side_m: float
    """From its middle to its sides, on average: fingers come down beside it."""
    spacing_m: Mapping[str, float] = field(default_factory=dict)
    """Least distance of middles from objects of other kinds when a table is set, by
    name of the kind; from the stick, to its axes. Where a pair has none, the discs and
    room for fingers."""
    grasp: Grasp | None = None
    """How it is held; None where it cannot be."""
    tops: tuple[Point, ...] = (_UP,)
    """Unit vectors in its frame of which one points up when it stands on a face: of a
    box six, of a cylinder two."""
    support_m: float | None = None
    """How far from its middle the middle of what lies on it may be; None where nothing
    can."""
    span_m: float | None = None
    """Between the middles of two things of one height that it lies across, half of it
    to each side along x; None for what lies on one thing."""
    drag_m: float | None = None
    """From its middle to where the stick touches it; None where the stick must not
    drag it."""
    obstacle: tuple[Capsule, ...]
    """Obstacles that arms under RMPflow avoid."""
    shell: Shell
    """Obstacles that the safety filter keeps arms clear of."""

    def __post_init__(self) -> None:
        """Check what would go wrong later.

        Raises:
            InvalidConfigError: The name cannot be part of an entity's, a length is not
                positive, or no gripper holds it as it says.
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
            raise self._error("what can move needs the mass of each of its parts")
        if self.grasp is not None:
            self._check_grasp(self.grasp)

    def _check_grasp(self, grasp: Grasp) -> None:
        if self.fixed:
            raise self._error("what is fixed to the table has no grasp")
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
    def colored(self) -> bool:
        """Whether there is one of each color."""
        return self.color is None

    @property
    def cargo(self) -> bool:
        """Whether it is there to be moved somewhere: no tool, not fixed."""
        return not (self.fixed or self.tool)

    @property
    def faceted(self) -> bool:
        """Whether it is grasped along its faces, which stacks then align."""
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
        """Return the least distance of the middles of two objects on a table [m]."""
        for one, two in ((self, other), (other, self)):
            if two.name in one.spacing_m:
                return one.spacing_m[two.name]
        return self.disc_m + other.disc_m + _FINGERS_BETWEEN_M


OBJECT_KINDS: Registry[ObjectKind] = Registry("object kind", ObjectKind)
"""Every kind of object that a scene may have, by name; built-in ones first."""


def box(name: str, size_m: Point, mass_kg: float, **details: Any) -> ObjectKind:
    """Return a solid box that lies on the table, is grasped, stacked and built upon.

    Args:
        name: Of the kind.
        size_m: Its edges along x, y and z [m].
        mass_kg: Its mass [kg].
        **details: Fields of :class:`ObjectKind` that differ from what follows from the
            sizes: ``grasp=None``, ``drag_m=0.03``.

    Raises:
        InvalidConfigError: No gripper can hold it.
    """
    x, y, z = size_m
    half = (x / 2, y / 2, z / 2)
    diagonal = math.hypot(half[0], half[1])
    square = x == y
    # The fingers close along y, the gripper's; across the narrower side.
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
    """Return a solid upright cylinder that is grasped, stacked and built upon.

    Args:
        name: Of the kind.
        radius_m: Its radius [m].
        height_m: Its height [m].
        mass_kg: Its mass [kg].
        **details: Fields of :class:`ObjectKind` that differ from what follows from the
            sizes: ``nouns=("can", "tin")``, ``drag_m=radius``.

    Raises:
        InvalidConfigError: No gripper can hold it.
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
    """Return a kind that stands on the table, with its frame in its middle."""
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
    """Return where to grasp: in the middle, but no deeper than the palm allows."""
    return max(height_m / 2, height_m - PALM_ABOVE_TCP_M + _CLEAR_OF_PALM_M)
