"""Solids that robots are drawn and collided with.

Collision geoms are a few capsules and boxes (group 3). Visible geoms never touch
anything (group 2). Neither has mass: links state their inertia themselves.
"""

import math
from dataclasses import dataclass

from lemma.core.engine import mujoco
from lemma.robots.ur.meshes import Surface, Vector

Rgba = tuple[float, float, float, float]

VISUAL_GROUP = 2
COLLISION_GROUP = 3

DARK: Rgba = (0.17, 0.18, 0.20, 1.0)
"""Seams, collars, the gripper."""
METAL: Rgba = (0.66, 0.68, 0.70, 1.0)
"""Flange and fingers."""
_COLLIDER: Rgba = (0.4, 0.7, 0.4, 0.5)


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

    @property
    def centre(self) -> Vector:
        """The point halfway [m]."""
        return _between(self, 0.5)


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
        rgba=_COLLIDER,
    )


def add_box(body: mujoco.MjsBody, name: str, shape: Box) -> mujoco.MjsGeom:
    """Add a collision box."""
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=list(shape.centre),
        size=[0.5 * edge for edge in shape.size],
        group=COLLISION_GROUP,
        rgba=_COLLIDER,
    )


def draw(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, surface: Surface, rgba: Rgba
) -> None:
    """Add a mesh that is only seen.

    Args:
        spec: The scene that is being built.
        body: Body that the mesh is fixed to.
        name: Name of the mesh; drawn a second time, it is shared.
        surface: Its triangles, in the frame of ``body``.
        rgba: Color.
    """
    if spec.mesh(name) is None:
        spec.add_mesh(
            name=name,
            uservert=surface.vertices,
            userface=surface.faces,
            # The mesh weighs nothing; this is the way to say so that costs least.
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
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
