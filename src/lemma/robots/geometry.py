"""Collision geoms and visible meshes of robots.

Collision geoms are a few capsules and boxes (group 3). Visible geoms do not collide
(group 2). Neither has mass: the inertia of links is set explicitly.
"""

import math
from dataclasses import dataclass

from lemma.core.engine import mujoco
from lemma.robots.ur.meshes import Surface, Vector

Rgba = tuple[float, float, float, float]

VISUAL_GROUP = 2
COLLISION_GROUP = 3

DARK: Rgba = (0.17, 0.18, 0.20, 1.0)
"""Color of seams, collars and the gripper."""
METAL: Rgba = (0.66, 0.68, 0.70, 1.0)
"""Color of the flange and the fingers."""
_COLLIDER: Rgba = (0.4, 0.7, 0.4, 0.5)


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A solid cylinder between two points in the frame of its body."""

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
        """Centre of the cylinder [m]."""
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
    """Add a visible mesh without collisions.

    Args:
        spec: The MuJoCo specification of the scene.
        body: Body that the mesh is fixed to.
        name: Name of the mesh; geoms with the same name share one mesh.
        surface: Its triangles, in the frame of ``body``.
        rgba: Color and opacity, each in [0, 1].
    """
    if spec.mesh(name) is None:
        spec.add_mesh(
            name=name,
            uservert=surface.vertices,
            userface=surface.faces,
            # The mesh has no mass; MuJoCo computes this inertia fastest.
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
    """Return the diagonal inertia of a solid cylinder along z [kg m2].

    Args:
        mass: Mass [kg].
        radius: Radius [m].
        length: Length [m].
    """
    across = mass * (3.0 * radius * radius + length * length) / 12.0
    return (across, across, 0.5 * mass * radius * radius)


def box_inertia(mass: float, size: Vector) -> Vector:
    """Return the diagonal inertia of a solid box [kg m2].

    Args:
        mass: Mass [kg].
        size: Full edge lengths along x, y, z [m].
    """
    x, y, z = (edge * edge for edge in size)
    return (mass * (y + z) / 12.0, mass * (x + z) / 12.0, mass * (x + y) / 12.0)


def set_inertia(
    body: mujoco.MjsBody, mass: float, centre: Vector, inertia: Vector
) -> None:
    """Set a body's mass and inertia, and compensate its gravity.

    Args:
        body: The body.
        mass: Mass [kg].
        centre: Centre of mass in the body frame [m].
        inertia: Diagonal inertia in the body frame [kg m2].
    """
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
