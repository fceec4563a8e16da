"""Visible meshes of UR arms: joint housings with lids, tubes between them, a flange.

Each joint is a motor housing with a rounded lid at one end and a dark seam to the next
link at the other; tubes and the next housing leave it at right angles. The meshes are
computed once per arm type from its parameters and do not collide. They consist of
lofts: a profile along an axis, swept around a circle or around a rectangle with rounded
corners. Edges sharper than :data:`_CREASE` stay sharp; all others are shaded smooth.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from lemma.robots.ur.arms import ArmSpec

Vector = tuple[float, float, float]
Ring = tuple[float, float]

# A profile that turns by more than this angle has a sharp edge [rad].
_CREASE = math.radians(50.0)


@dataclass(frozen=True, slots=True)
class Loft:
    """A solid around an axis; an end that another solid hides stays open."""

    origin: Vector
    """Start of the axis, in the frame of the body [m]."""
    axis: Vector
    """Unit vector parallel to one of the body's axes, in either direction."""
    profile: tuple[Ring, ...]
    """(height, radius) from the bottom to the top [m]."""
    segments: int = 20
    """Number of sides that approximate a circle; a multiple of four."""
    closed: tuple[bool, bool] = (False, False)
    """Whether bottom and top have a cap."""
    half_flat: tuple[float, float] = (0.0, 0.0)
    """Half the lengths of the straight sides of a rounded rectangle [m]; zero for a
    circle."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A triangle mesh."""

    vertices: tuple[float, ...]
    """x, y, z of each vertex [m]."""
    faces: tuple[int, ...]
    """Indices of the vertices of each triangle, counter-clockwise from outside."""


def mesh(lofts: Iterable[Loft]) -> Surface:
    """Return the triangles of several solids as one mesh."""
    vertices: list[float] = []
    faces: list[int] = []
    for loft in lofts:
        _append(loft, vertices, faces)
    return Surface(tuple(vertices), tuple(faces))


def rounded(start: float, end: float, radius: float, edge: float) -> tuple[Ring, ...]:
    """Return the profile of a cylinder with a rounded upper edge.

    Args:
        start: Height of the bottom [m].
        end: Height of the top [m].
        radius: Radius of the cylinder [m].
        edge: Radius of the edge [m].
    """
    bends = (0.0, math.radians(45.0), math.radians(90.0))
    top = (
        (
            end - edge * (1.0 - math.sin(bend)),
            radius - edge * (1.0 - math.cos(bend)),
        )
        for bend in bends
    )
    return ((start, radius), *top)


def _append(loft: Loft, vertices: list[float], faces: list[int]) -> None:
    """Add the triangles of one solid."""
    count = loft.segments
    profile = loft.profile
    directions = [math.atan2(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(profile)]
    # Directions of the profile on the caps: outwards at the bottom, inwards at the top.
    directions = [0.0, *directions, math.pi]
    ring = _add_ring(loft, vertices, profile[0])
    if loft.closed[0]:
        pole = _add_point(loft, vertices, profile[0][0])
        faces += _fan(pole, ring, count, bottom=True)
    for index, (_, upper) in enumerate(pairwise(profile)):
        sharp = abs(directions[index + 1] - directions[index]) > _CREASE
        if sharp and (index or loft.closed[0]):
            ring = _add_ring(loft, vertices, profile[index])
        above = _add_ring(loft, vertices, upper)
        faces += _band(ring, above, count)
        ring = above
    if not loft.closed[1]:
        return
    if abs(directions[-1] - directions[-2]) > _CREASE:
        ring = _add_ring(loft, vertices, profile[-1])
    pole = _add_point(loft, vertices, profile[-1][0])
    faces += _fan(pole, ring, count, bottom=False)


def _band(lower: int, upper: int, count: int) -> list[int]:
    faces: list[int] = []
    for i in range(count):
        j = (i + 1) % count
        faces += [lower + i, lower + j, upper + j, lower + i, upper + j, upper + i]
    return faces


def _fan(pole: int, ring: int, count: int, *, bottom: bool) -> list[int]:
    faces: list[int] = []
    for i in range(count):
        j = (i + 1) % count
        faces += [pole, ring + j, ring + i] if bottom else [pole, ring + i, ring + j]
    return faces


def _add_ring(loft: Loft, vertices: list[float], ring: Ring) -> int:
    """Add one ring of vertices and return the index of its first."""
    first = len(vertices) // 3
    height, radius = ring
    flat_x, flat_y = loft.half_flat
    for i in range(loft.segments):
        # An offset of half a step gives each corner a quarter of the vertices.
        angle = math.tau * (i + 0.5) / loft.segments
        cos, sin = math.cos(angle), math.sin(angle)
        _add_vertex(
            loft,
            vertices,
            radius * cos + math.copysign(flat_x, cos),
            radius * sin + math.copysign(flat_y, sin),
            height,
        )
    return first


def _add_point(loft: Loft, vertices: list[float], height: float) -> int:
    first = len(vertices) // 3
    _add_vertex(loft, vertices, 0.0, 0.0, height)
    return first


def _add_vertex(
    loft: Loft, vertices: list[float], x: float, y: float, z: float
) -> None:
    """Add a vertex with coordinates across (x, y) and along (z) the axis [m]."""
    ax, ay, az = loft.axis
    # The two next axes of the body in cyclic order: a right-handed frame.
    across = (az, ax, ay)
    over = (
        ay * across[2] - az * across[1],
        az * across[0] - ax * across[2],
        ax * across[1] - ay * across[0],
    )
    vertices += [
        loft.origin[k] + x * across[k] + y * over[k] + z * loft.axis[k]
        for k in range(3)
    ]


LID = 1.1
"""Length of housings beyond the axis that crosses them, in radii."""

_EDGE = 0.35
"""Radius of the lids' edges, in radii of the housing."""
_INSET = 0.985
"""Radius of lids and seams, in radii of the housing: slightly inside the shell."""
_SEAM_M = 0.006
_ORIGIN: Vector = (0, 0, 0)
_Z: Vector = (0, 0, 1)

Look = dict[str, Surface]
"""The meshes of one link by material: ``shell``, ``dark``, ``lid`` or ``metal``."""


@lru_cache
def looks(arm: ArmSpec) -> dict[str, Look]:
    """Return the visible meshes of each link, in its frame."""
    return {
        "base": _base(arm),
        "shoulder": _shoulder(arm),
        "upper_arm": _upper_arm(arm),
        "forearm": _forearm(arm),
        "wrist_1": _wrist(arm, arm.d4, (0, -1, 0), _wrist_seam(arm), arm.d5),
        "wrist_2": _wrist(arm, arm.d5, (0, 1, 0), 0.5 * arm.d5, arm.d6),
        "wrist_3": _flange(arm),
    }


def _base(arm: ArmSpec) -> Look:
    radius = arm.shoulder_radius
    plate, top = 0.2 * radius, _base_top(arm)
    foot = ((0.0, 1.25 * radius), (plate, 1.25 * radius), (plate, radius))
    column = ((plate, radius), (top - _SEAM_M, radius))
    seam = ((top - _SEAM_M, _INSET * radius), (top, _INSET * radius))
    return {
        "dark": mesh([Loft(_ORIGIN, _Z, foot), Loft(_ORIGIN, _Z, seam)]),
        "shell": mesh([Loft(_ORIGIN, _Z, column)]),
    }


def _shoulder(arm: ArmSpec) -> Look:
    radius = arm.shoulder_radius
    stub = ((_base_top(arm), radius), (arm.d1, radius))
    look = _motor((0, 0, arm.d1), (0, -1, 0), radius, 0.5 * arm.shoulder_offset)
    look["shell"].append(Loft(_ORIGIN, _Z, stub))
    return _meshes(look)


def _upper_arm(arm: ArmSpec) -> Look:
    side, near, far = arm.shoulder_offset, arm.shoulder_radius, arm.elbow_radius
    # The lid of the elbow's motor faces away from the base, its seam towards it.
    look = _motor((-arm.a2, 0, side), (0, 0, -1), far, -0.5 * arm.elbow_offset)
    end = rounded(0.5 * side, side + LID * near, near, _EDGE * near)
    look["shell"].append(Loft(_ORIGIN, _Z, end, closed=(False, True)))
    _add_tube(look, (0, 0, side), (near, far), arm.upper_tube_radius, arm.a2)
    return _meshes(look)


def _forearm(arm: ArmSpec) -> Look:
    side = arm.shoulder_offset + arm.elbow_offset
    near, far = arm.elbow_radius, arm.wrist_radius
    look = _motor((-arm.a3, 0, side), _Z, far, _wrist_seam(arm) - side)
    end = rounded(0.5 * arm.elbow_offset, LID * near, near, _EDGE * near)
    look["shell"].append(Loft((0, 0, side), (0, 0, -1), end, closed=(False, True)))
    _add_tube(look, (0, 0, side), (near, far), arm.forearm_tube_radius, arm.a3)
    return _meshes(look)


def _wrist(
    arm: ArmSpec, height: float, axis: Vector, seam: float, length: float
) -> Look:
    """Return the meshes of a wrist: a stub from the last seam and a motor across it."""
    radius = arm.wrist_radius
    look = _motor((0, 0, height), axis, radius, 0.5 * length)
    look["shell"].append(Loft(_ORIGIN, _Z, ((seam, radius), (height, radius))))
    return _meshes(look)


def _flange(arm: ArmSpec) -> Look:
    profile = rounded(0.5 * arm.d6, arm.d6, arm.wrist_radius, 0.1 * arm.wrist_radius)
    return {"metal": mesh([Loft(_ORIGIN, _Z, profile, closed=(False, True))])}


def _motor(
    centre: Vector, axis: Vector, radius: float, seam: float
) -> dict[str, list[Loft]]:
    """Return a motor housing from its lid to the seam where the next link turns.

    Args:
        centre: Intersection of the axes of the housing and its link [m].
        axis: Unit vector from the lid to the seam.
        radius: Radius of the housing [m].
        seam: Distance of the seam from the centre along the axis [m].
    """
    x, y, z = axis
    split = (LID - 0.45) * radius
    lid = rounded(split - _SEAM_M, LID * radius, _INSET * radius, _EDGE * radius)
    shell = ((-split, radius), (seam - _SEAM_M, radius))
    ring = ((seam - _SEAM_M, _INSET * radius), (seam, _INSET * radius))
    return {
        "lid": [Loft(centre, (-x, -y, -z), lid, closed=(False, True))],
        "shell": [Loft(centre, axis, shell)],
        "dark": [Loft(centre, axis, ring)],
    }


def _add_tube(
    look: dict[str, list[Loft]],
    origin: Vector,
    housings: tuple[float, float],
    radius: float,
    length: float,
) -> None:
    """Add the tube between two housings, with a collar at each end."""
    near, far = 1.08 * housings[0], length - 1.08 * housings[1]
    width = 0.2 * radius
    along: Vector = (-1, 0, 0)
    tube = ((0.0, radius), (length, radius))
    look["shell"].append(Loft(origin, along, tube))
    for start in (near, far - width):
        ring = ((start, 1.035 * radius), (start + width, 1.035 * radius))
        look["dark"].append(Loft(origin, along, ring))


def _base_top(arm: ArmSpec) -> float:
    """Return the height of the seam between base and shoulder [m]."""
    return 0.42 * arm.d1


def _wrist_seam(arm: ArmSpec) -> float:
    """Return the position of the seam of wrist 1 along its axis [m]."""
    return 0.5 * (arm.shoulder_offset + arm.elbow_offset + arm.d4)


def _meshes(look: dict[str, list[Loft]]) -> Look:
    return {material: mesh(lofts) for material, lofts in look.items()}
