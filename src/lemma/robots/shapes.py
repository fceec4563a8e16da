"""Solids that robots are drawn and collided with.

What collides is a capsule or a box (few, group 3); what is seen never touches
anything (group 2). Neither carries mass: links state their inertia themselves.
"""

import math
from dataclasses import dataclass

import mujoco

Vector = tuple[float, float, float]

VISUAL_GROUP = 2
COLLISION_GROUP = 3


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A round solid from one point to another, in the frame of its body."""

    start: Vector
    """Centre of the first end [m]."""
    end: Vector
    """Centre of the second end [m]."""
    radius: float
    """Radius [m]."""

    @property
    def length(self) -> float:
        """Distance between the ends [m]."""
        return math.dist(self.start, self.end)


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the axes of its body."""

    centre: Vector
    """Centre [m]."""
    size: Vector
    """Full edge lengths along x, y, z [m]."""


def add_capsule(body: mujoco.MjsBody, name: str, shape: Cylinder) -> mujoco.MjsGeom:
    """Add a collision capsule that ends flush with the ends of ``shape``."""
    inset = min(shape.radius, 0.499 * shape.length) / shape.length
    start, end = (_between(shape, inset), _between(shape, 1.0 - inset))
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[*start, *end],
        size=[shape.radius, 0, 0],
        group=COLLISION_GROUP,
        rgba=[0.4, 0.7, 0.4, 0.5],
    )


def add_box(body: mujoco.MjsBody, name: str, shape: Box) -> mujoco.MjsGeom:
    """Add a collision box."""
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=list(shape.centre),
        size=[0.5 * edge for edge in shape.size],
        group=COLLISION_GROUP,
        rgba=[0.4, 0.7, 0.4, 0.5],
    )


def draw_cylinder(body: mujoco.MjsBody, shape: Cylinder, rgba: list[float]) -> None:
    """Add a cylinder that is only seen."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        fromto=[*shape.start, *shape.end],
        size=[shape.radius, 0, 0],
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        rgba=rgba,
    )


def draw_box(body: mujoco.MjsBody, shape: Box, rgba: list[float]) -> None:
    """Add a box that is only seen."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=list(shape.centre),
        size=[0.5 * edge for edge in shape.size],
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        rgba=rgba,
    )


def cylinder_inertia(mass: float, radius: float, length: float) -> Vector:
    """Return the inertia [kg m2] across, across and along a solid cylinder."""
    across = mass * (3.0 * radius * radius + length * length) / 12.0
    return (across, across, 0.5 * mass * radius * radius)


def box_inertia(mass: float, size: Vector) -> Vector:
    """Return the inertia [kg m2] of a solid box about its axes."""
    x, y, z = (edge * edge for edge in size)
    return (mass * (y + z) / 12.0, mass * (x + z) / 12.0, mass * (x + y) / 12.0)


def set_inertia(
    body: mujoco.MjsBody, mass: float, centre: Vector, inertia: Vector
) -> None:
    """State a body's inertia, diagonal in the body frame, and lift its weight."""
    body.explicitinertial = True
    body.mass = mass
    body.ipos = list(centre)
    body.inertia = list(inertia)
    body.gravcomp = 1.0


def _between(shape: Cylinder, fraction: float) -> Vector:
    (x0, y0, z0), (x1, y1, z1) = shape.start, shape.end
    return (
        x0 + fraction * (x1 - x0),
        y0 + fraction * (y1 - y0),
        z0 + fraction * (z1 - z0),
    )
