"""MuJoCo bodies of the UR family, built from the parameters of an arm.

Frames follow the maker's (standard) Denavit-Hartenberg convention,
``T_i = RotZ(q_i) TransZ(d_i) TransX(a_i) RotX(alpha_i)``. The body that joint i moves
is at frame i - 1 and turns about its z axis, so the compiled model computes this
product. At zero joint angles the arm lies along the base's negative x axis, as on the
real robot.

Integrate the servos' damping explicitly (``mjINT_EULER``). An implicit integrator
reduces accelerations after MuJoCo has solved for the contacts, so that objects slip in
the gripper of a moving arm. Explicit damping is stable here because the rotors' inertia
is at least ``h * damping / 0.9`` at a time step of ``h`` = 5 ms.
"""

import math

from lemma.core.arguments import known
from lemma.core.engine import mujoco
from lemma.core.poses import Pose2
from lemma.robots.geometry import (
    DARK,
    METAL,
    Cylinder,
    Rgba,
    add_capsule,
    cylinder_inertia,
    draw,
    set_inertia,
)
from lemma.robots.gripper_body import add_gripper
from lemma.robots.hand import STANDARD
from lemma.robots.ur.arms import ARMS, JOINTS, LINKS, ArmSpec
from lemma.robots.ur.meshes import LID, looks

__all__ = ["ARMS", "COLORS", "JOINTS", "LINKS", "ArmSpec", "add_arm"]

COLORS: dict[str, Rgba] = {
    "red": (0.74, 0.07, 0.06, 1.0),
    "white": (0.92, 0.92, 0.90, 1.0),
    "blue": (0.08, 0.24, 0.66, 1.0),
    "green": (0.08, 0.44, 0.18, 1.0),
}
"""Colors of the robots."""

_LID_BLUE: Rgba = (0.45, 0.66, 0.82, 1.0)


def add_arm(
    spec: mujoco.MjSpec,
    arm: ArmSpec,
    prefix: str,
    base: Pose2,
    color: str,
    hand: str = STANDARD,
) -> None:
    """Add an arm with its gripper to a scene.

    Args:
        spec: The MuJoCo specification of the scene, with angles in radians.
        arm: Parameters of the arm.
        prefix: Name of the robot; every name of its parts begins with it.
        base: World from base.
        color: A name in :data:`COLORS`.
        hand: A name in :data:`~lemma.robots.hand.HANDS`.

    Raises:
        UnknownNameError: No robot has that color.
    """
    known("robot color", color, COLORS)
    spec.compiler.degree = False
    half = 0.5 * base.yaw
    body = spec.worldbody.add_body(
        name=f"{prefix}/base",
        pos=[base.x, base.y, 0.0],
        quat=[math.cos(half), 0.0, 0.0, math.sin(half)],
    )
    solids = _solids(arm)
    _dress(spec, body, arm, "base", color)
    _add_capsules(body, solids["base"])
    rows = _dh_rows(arm)
    position, rotation = (0.0, 0.0, 0.0), 0.0
    for index, link in enumerate(LINKS):
        body = body.add_body(
            name=f"{prefix}/{link}",
            pos=list(position),
            quat=[math.cos(0.5 * rotation), math.sin(0.5 * rotation), 0.0, 0.0],
        )
        _add_joint(spec, body, arm, prefix, index)
        _dress(spec, body, arm, link, color)
        _add_capsules(body, solids[link])
        _weigh(body, arm.link_masses[index], solids[link][0])
        d, a, rotation = rows[index]
        position = (a, 0.0, d)
    add_gripper(spec, body, prefix, arm.d6, hand)
    # MuJoCo excludes contacts between parent and child, but not for the fixed base.
    spec.add_exclude(bodyname1=f"{prefix}/base", bodyname2=f"{prefix}/shoulder")


def _dh_rows(arm: ArmSpec) -> tuple[tuple[float, float, float], ...]:
    """Return (d, a, alpha) of the six joints [m, m, rad]."""
    quarter = 0.5 * math.pi
    return (
        (arm.d1, 0.0, quarter),
        (0.0, -arm.a2, 0.0),
        (0.0, -arm.a3, 0.0),
        (arm.d4, 0.0, quarter),
        (arm.d5, 0.0, -quarter),
        (arm.d6, 0.0, 0.0),
    )


def _add_joint(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, arm: ArmSpec, prefix: str, index: int
) -> None:
    """Add a hinge about the body's z axis, with its position servo."""
    name = f"{prefix}/{JOINTS[index]}"
    limit, effort = arm.joint_range[index], arm.effort_limits[index]
    stiffness, damping = arm.stiffness[index], arm.damping[index]
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        limited=True,
        range=[-limit, limit],
        armature=arm.armature[index],
    )
    spec.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[stiffness, *[0.0] * 9],
        biasprm=[0.0, -stiffness, -damping, *[0.0] * 7],
        ctrllimited=True,
        ctrlrange=[-limit, limit],
        forcelimited=True,
        forcerange=[-effort, effort],
    )


def _solids(arm: ArmSpec) -> dict[str, tuple[Cylinder, ...]]:
    """Return the collision solids of each link, in its frame, the heaviest first.

    Two housings that meet at a joint form one solid of revolution about its axis, so
    one capsule covers both.
    """
    upper = arm.shoulder_offset
    lower = upper + arm.elbow_offset
    shoulder, elbow, wrist = arm.shoulder_radius, arm.elbow_radius, arm.wrist_radius
    top, bottom = upper + LID * elbow, lower - LID * elbow
    back, front = LID * shoulder, upper + LID * shoulder
    return {
        "base": (Cylinder((0, 0, 0), (0, 0, arm.d1), shoulder),),
        "shoulder": (Cylinder((0, back, arm.d1), (0, -front, arm.d1), shoulder),),
        "upper_arm": (
            Cylinder((0, 0, upper), (-arm.a2, 0, upper), arm.upper_tube_radius),
            Cylinder((-arm.a2, 0, top), (-arm.a2, 0, bottom), elbow),
        ),
        "forearm": (
            Cylinder((0, 0, lower), (-arm.a3, 0, lower), arm.forearm_tube_radius),
        ),
        "wrist_1": (
            Cylinder((0, 0, lower - LID * wrist), (0, 0, arm.d4 + wrist), wrist),
        ),
        "wrist_2": (Cylinder((0, 0, -LID * wrist), (0, 0, arm.d5 + wrist), wrist),),
        "wrist_3": (Cylinder((0, 0, -LID * wrist), (0, 0, arm.d6), wrist),),
    }


def _add_capsules(body: mujoco.MjsBody, solids: tuple[Cylinder, ...]) -> None:
    for index, solid in enumerate(solids):
        add_capsule(body, f"{body.name}_{index}", solid)


def _dress(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, arm: ArmSpec, link: str, color: str
) -> None:
    """Add the visible meshes of a link; arms of one type share them."""
    paints = {
        "shell": COLORS[color],
        "dark": DARK,
        "lid": _LID_BLUE,
        "metal": METAL,
    }
    for material, surface in looks(arm)[link].items():
        draw(spec, body, f"{arm.name}/{link}/{material}", surface, paints[material])


def _weigh(body: mujoco.MjsBody, mass: float, solid: Cylinder) -> None:
    """Set a link's inertia to that of its main solid."""
    across, _, along = cylinder_inertia(mass, solid.radius, solid.length)
    spans = [abs(b - a) for a, b in zip(solid.start, solid.end, strict=True)]
    x, y, z = (along if span == max(spans) else across for span in spans)
    set_inertia(body, mass, solid.centre, (x, y, z))
