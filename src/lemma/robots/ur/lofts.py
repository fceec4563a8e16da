"""Small meshes that are only seen: rounded solids, as few triangles as look round.

A loft carries a profile along an axis around a circle, or around a rectangle with
rounded corners. Edges sharper than a crease stay sharp, all others are shaded round.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

Vector = tuple[float, float, float]
Ring = tuple[float, float]

# Profiles that turn by more than this keep a sharp edge [rad].
_CREASE = math.radians(50.0)


@dataclass(frozen=True, slots=True)
class Loft:
    """A solid around an axis, open where another solid hides its end."""

    origin: Vector
    """Where the axis starts, in the frame of the body [m]."""
    axis: Vector
    """Unit vector along one of the body's axes, or against it."""
    profile: tuple[Ring, ...]
    """(height, radius) from the bottom to the top [m]."""
    segments: int = 20
    """How many sides stand for a circle; a multiple of four."""
    closed: tuple[bool, bool] = (False, False)
    """Whether bottom and top can be seen and so need a cap."""
    half_flat: tuple[float, float] = (0.0, 0.0)
    """Half the straight sides of a rounded rectangle; zero: a circle [m]."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A triangle mesh."""

    vertices: tuple[float, ...]
    """x, y, z of each vertex [m]."""
    faces: tuple[int, ...]
    """Three vertices of each triangle, counter-clockwise from outside."""


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
    # A cap runs outwards at the bottom, inwards at the top.
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
        # Half a step off the axes: each corner gets a quarter of the vertices.
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
    """Add a point given across and along the axis."""
    ax, ay, az = loft.axis
    # The next axis of the body, cyclically, and the one after: right-handed.
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
