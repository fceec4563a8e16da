"""MuJoCo bodies of objects, built from their kinds."""

import math

from lemma.core.engine import mujoco
from lemma.core.poses import Pose2
from lemma.scene.objects.entity import Entity
from lemma.scene.objects.kind import Part

# A time constant of two time steps is the shortest one without bouncing.
CONTACT_SOLREF = (0.01, 1.0)
CONTACT_SOLIMP = (0.98, 0.999, 0.0005, 0.5, 2.0)
OBJECT_FRICTION = (0.25, 0.01, 0.0002)
"""Sliding, torsional [m] and rolling [m] friction of waxed wood. With more friction, a
pushed cube stutters and hops."""

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


def add_object(spec: mujoco.MjSpec, entity: Entity, pose: Pose2) -> mujoco.MjsBody:
    """Add one object on the table to the world body.

    An object that is not fixed to the table is a free body; its joint has its name.

    Args:
        spec: The MuJoCo specification of the scene, with angles in radians.
        entity: The entity.
        pose: World from object.

    Returns:
        The body, which has the entity's name.
    """
    kind, name = entity.kind, entity.name
    body = spec.worldbody.add_body(
        name=name,
        pos=[pose.x, pose.y, kind.origin_m],
        quat=resting_quaternion(pose.yaw),
    )
    if not kind.fixed:
        body.add_freejoint(name=name)
    for part in kind.parts:
        _add_part(body, entity, part)
    if kind.build is not None:
        kind.build(spec, body, name)
    return body


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
