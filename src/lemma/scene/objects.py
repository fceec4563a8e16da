"""Cubes, pads and the stick: sizes, masses and contact, as MuJoCo bodies."""

import math

from lemma.core.engine import mujoco
from lemma.core.poses import Pose2
from lemma.scene.palette import OBJECT_COLORS, STICK, Rgba
from lemma.scene.spec import ObjectPlacement

CUBE_EDGE_M = 0.05
CUBE_MASS_KG = 0.09
"""A wooden block of 720 kg/m3."""

PAD_RADIUS_M = 0.06
PAD_THICKNESS_M = 0.004

HANDLE_LENGTH_M = 0.50
HOOK_LENGTH_M = 0.15
STICK_SECTION_M = 0.03
STICK_DENSITY = 180.0
"""[kg/m3], a foam-filled tube: light enough to be held at one end by friction."""

# Two time steps are the shortest time constant without bouncing.
CONTACT_SOLREF = (0.01, 1.0)
CONTACT_SOLIMP = (0.98, 0.999, 0.0005, 0.5, 2.0)
OBJECT_FRICTION = (0.25, 0.01, 0.0002)
"""Sliding, torsional [m] and rolling [m] friction: waxed wood. With more, a cube that
is pushed along stutters and hops."""


def height_m(kind: str) -> float:
    """Return how high the top of an object of a kind is above what it lies on [m]."""
    return {"cube": CUBE_EDGE_M, "pad": PAD_THICKNESS_M, "stick": STICK_SECTION_M}[kind]


def resting_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion ``wxyz`` of a turn about the vertical."""
    return (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))


def add_object(spec: mujoco.MjSpec, placed: ObjectPlacement) -> None:
    """Add one object to the world body.

    Cubes and the stick are free bodies with a joint of the same name; pads are fixed to
    the table. The body frame of a cube is its centre; of the stick, the free end of its
    handle at half height; of a pad, its centre on the table.
    """
    {"cube": _add_cube, "pad": _add_pad, "stick": _add_stick}[placed.kind](spec, placed)


def _add_cube(spec: mujoco.MjSpec, placed: ObjectPlacement) -> None:
    half = CUBE_EDGE_M / 2
    body = _free_body(spec, placed.name, placed.pose, half)
    _add_box(
        body,
        placed.name,
        (0.0, 0.0, 0.0),
        (half, half, half),
        OBJECT_COLORS[placed.color],
        CUBE_MASS_KG,
    )


def _add_pad(spec: mujoco.MjSpec, placed: ObjectPlacement) -> None:
    half = PAD_THICKNESS_M / 2
    body = spec.worldbody.add_body(
        name=placed.name,
        pos=[placed.pose.x, placed.pose.y, 0.0],
        quat=resting_quaternion(placed.pose.yaw),
    )
    body.add_geom(
        name=placed.name,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[0, 0, half],
        size=[PAD_RADIUS_M, half, 0],
        rgba=OBJECT_COLORS[placed.color],
        friction=OBJECT_FRICTION,
        solref=CONTACT_SOLREF,
        solimp=CONTACT_SOLIMP,
        condim=4,
    )


def _add_stick(spec: mujoco.MjSpec, placed: ObjectPlacement) -> None:
    half = STICK_SECTION_M / 2
    body = _free_body(spec, placed.name, placed.pose, half)
    area = STICK_SECTION_M * STICK_SECTION_M
    _add_box(
        body,
        "stick/handle",
        (HANDLE_LENGTH_M / 2, 0.0, 0.0),
        (HANDLE_LENGTH_M / 2, half, half),
        STICK,
        STICK_DENSITY * area * HANDLE_LENGTH_M,
    )
    # The hook's length counts from the handle's far side, so the bar starts inside it.
    bar = HOOK_LENGTH_M - STICK_SECTION_M
    _add_box(
        body,
        "stick/hook",
        (HANDLE_LENGTH_M - half, half + bar / 2, 0.0),
        (half, bar / 2, half),
        STICK,
        STICK_DENSITY * area * bar,
    )


def _free_body(
    spec: mujoco.MjSpec, name: str, pose: Pose2, height: float
) -> mujoco.MjsBody:
    body = spec.worldbody.add_body(
        name=name, pos=[pose.x, pose.y, height], quat=resting_quaternion(pose.yaw)
    )
    body.add_freejoint(name=name)
    return body


def _add_box(
    body: mujoco.MjsBody,
    name: str,
    position: tuple[float, float, float],
    half_size: tuple[float, float, float],
    color: Rgba,
    mass_kg: float,
) -> None:
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=position,
        size=half_size,
        rgba=color,
        mass=mass_kg,
        friction=OBJECT_FRICTION,
        solref=CONTACT_SOLREF,
        solimp=CONTACT_SOLIMP,
        condim=4,
    )
