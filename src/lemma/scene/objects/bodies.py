"""MuJoCo bodies of objects, built from their kinds."""

import math

from lemma.core.engine import mujoco
from lemma.core.poses import Pose2
from lemma.robots.geometry import DARK, VISUAL_GROUP
from lemma.robots.hand import RUBBER_FRICTION, RUBBER_SOLIMP, RUBBER_SOLREF
from lemma.scene.objects.entity import Entity
from lemma.scene.objects.kind import Part

# A time constant of two time steps is the shortest one without bouncing.
CONTACT_SOLREF = (0.01, 1.0)
CONTACT_SOLIMP = (0.98, 0.999, 0.0005, 0.5, 2.0)
OBJECT_FRICTION = (0.25, 0.01, 0.0002)
"""Sliding, torsional [m] and rolling [m] friction of waxed wood. With more friction, a
pushed cube stutters and hops."""

_RIM_M = 0.0035
"""Half the width of a rim."""
_PROUD_M = 0.0003
"""By how much it stands out, so that it is seen."""

FALLEN = 2
"""Contact bit of the floor and of movable objects; arms do not collide with the floor.
"""

_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}


def resting_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion ``wxyz`` of a rotation about the vertical by yaw [rad]."""
    return (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))


def add_object(
    spec: mujoco.MjSpec,
    entity: Entity,
    pose: Pose2,
    mass_kg: float | None = None,
    height_m: float = 0.0,
) -> mujoco.MjsBody:
    """Add one object on the table or on a tray to the world body.

    An object that is not fixed to the table is a free body; its joint has its name.

    Args:
        spec: The MuJoCo specification of the scene, with angles in radians.
        entity: The entity.
        pose: World from object.
        mass_kg: Mass of an object that has another one than its kind, of one part [kg].
            It then has a skin of rubber, and dark rims, which are only visible.
        height_m: Height of its support above the table [m].

    Returns:
        The body, which has the entity's name.
    """
    kind, name = entity.kind, entity.name
    body = spec.worldbody.add_body(
        name=name,
        pos=[pose.x, pose.y, height_m + kind.origin_m],
        quat=resting_quaternion(pose.yaw),
    )
    if not kind.fixed:
        body.add_freejoint(name=name)
    for part in kind.parts:
        _add_part(body, entity, part)
    if kind.build is not None:
        kind.build(spec, body, name)
    if mass_kg is not None:
        _make_heavy(spec.geom(name), mass_kg)
        _add_rims(body, kind.parts[0])
    return body


def _make_heavy(geom: mujoco.MjsGeom, mass_kg: float) -> None:
    """Give an object a mass of its own, and a skin of the fingers' rubber.

    Its friction is the same on all that it touches. So a hand that presses it against
    something and rises does not lift it: it is held back as much as it is lifted.
    """
    geom.mass = mass_kg
    geom.priority = 1
    geom.friction = RUBBER_FRICTION
    geom.solref = RUBBER_SOLREF
    geom.solimp = RUBBER_SOLIMP


def _add_rims(body: mujoco.MjsBody, part: Part) -> None:
    """Draw a dark bar along each edge of a box; nothing touches them."""
    half = part.size_m
    for along in range(3):
        for first in (-1.0, 1.0):
            for second in (-1.0, 1.0):
                side = iter((first, second))
                middle = [
                    0.0 if axis == along else next(side) * (half[axis] - _RIM_M)
                    for axis in range(3)
                ]
                size = [_RIM_M + _PROUD_M] * 3
                size[along] = half[along] + _PROUD_M
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    pos=middle,
                    size=size,
                    rgba=DARK,
                    group=VISUAL_GROUP,
                    contype=0,
                    conaffinity=0,
                    mass=0.0,
                )


def _add_part(body: mujoco.MjsBody, entity: Entity, part: Part) -> None:
    geom = body.add_geom(
        name=f"{entity.name}/{part.name}" if part.name else entity.name,
        type=_GEOMS[part.shape],
        pos=part.position_m,
        size=[*part.size_m, *[0.0] * (3 - len(part.size_m))],
        rgba=entity.rgba,
        friction=OBJECT_FRICTION,
        solref=CONTACT_SOLREF,
        solimp=CONTACT_SOLIMP,
        condim=4,
        conaffinity=1 if entity.kind.fixed else 1 | FALLEN,
    )
    if part.mass_kg is not None:
        geom.mass = part.mass_kg
