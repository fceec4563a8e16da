"""The UR family: one parametric arm, described by numbers and built as bodies.

Frames follow the standard Denavit-Hartenberg convention of the maker:
``T_i = RotZ(q_i) TransZ(d_i) TransX(a_i) RotX(alpha_i)``. The body that joint i moves
sits at frame i - 1 and turns about its z axis, so the compiled model *is* the product.
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from lemma.core.errors import UnknownNameError
from lemma.core.poses import FloatArray, Pose2
from lemma.core.registry import Registry
from lemma.robots.gripper import add_gripper
from lemma.robots.shapes import (
    Cylinder,
    Vector,
    add_capsule,
    cylinder_inertia,
    draw_cylinder,
    set_inertia,
)

Six = tuple[float, float, float, float, float, float]

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
COLOURS: dict[str, list[float]] = {
    "red": [0.72, 0.08, 0.07, 1.0],
    "white": [0.90, 0.91, 0.91, 1.0],
}

_LID = [0.49, 0.67, 0.80, 1.0]
_DARK = [0.20, 0.21, 0.22, 1.0]


@dataclass(frozen=True, kw_only=True)
class ArmSpec:
    """The numbers that make one arm of the family."""

    name: str
    """Name in the registry."""
    d1: float
    """Height of the shoulder above the base [m]."""
    a2: float
    """Length of the upper arm [m]."""
    a3: float
    """Length of the forearm [m]."""
    d4: float
    """Offset of wrist 1 along the shoulder axis [m]."""
    d5: float
    """Offset of wrist 2 along the axis of joint 5 [m]."""
    d6: float
    """Offset of the flange along the axis of joint 6 [m]."""
    shoulder_offset: float
    """Offset of the upper arm's tube along the shoulder axis [m]."""
    elbow_offset: float
    """Offset from there to the forearm's tube; negative: back again [m]."""
    link_masses: Six
    """Masses, shoulder to wrist 3 [kg]."""
    effort_limits: Six
    """Largest joint torques [N m]."""
    velocity_limits: Six
    """Largest joint speeds [rad/s]."""
    payload_kg: float
    """What the arm may carry, gripper included."""
    shoulder_radius: float
    """Radius of the shoulder's housings [m]."""
    elbow_radius: float
    """Radius of the elbow's housings [m]."""
    wrist_radius: float
    """Radius of the wrists' housings [m]."""
    upper_tube_radius: float
    """Radius of the upper arm's tube [m]."""
    forearm_tube_radius: float
    """Radius of the forearm's tube [m]."""
    stiffness: Six
    """Servo gains on position [N m/rad]."""
    lag_s: float
    """Gain on velocity over gain on position: how far, in time, a moving arm trails.

    One figure for all joints, so that trailing leaves the shape of a path alone.
    """
    armature: Six
    """Inertias of the rotors, seen through the gears [kg m2]."""
    joint_range: Six = (math.tau, math.tau, math.pi, math.tau, math.tau, math.tau)
    """Joint limits, symmetric about zero [rad]."""

    @property
    def dh(self) -> FloatArray:
        """Return ``[d1, a2, a3, d4, d5, d6]``, shape (6,) [m]."""
        return np.array([self.d1, self.a2, self.a3, self.d4, self.d5, self.d6])


ARMS: Registry[ArmSpec] = Registry("arm")
ARMS.add(
    "ur5",
    ArmSpec(
        name="ur5",
        d1=0.089159,
        a2=0.425,
        a3=0.39225,
        d4=0.10915,
        d5=0.09465,
        d6=0.0823,
        shoulder_offset=0.13585,
        elbow_offset=-0.1197,
        link_masses=(3.7, 8.393, 2.275, 1.219, 1.219, 0.1879),
        effort_limits=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
        velocity_limits=(3.15, 3.15, 3.15, 3.2, 3.2, 3.2),
        payload_kg=5.0,
        shoulder_radius=0.060,
        elbow_radius=0.056,
        wrist_radius=0.040,
        upper_tube_radius=0.050,
        forearm_tube_radius=0.038,
        stiffness=(30000.0, 30000.0, 20000.0, 4000.0, 4000.0, 4000.0),
        lag_s=0.025,
        armature=(4.2, 4.2, 2.8, 0.56, 0.56, 0.56),
    ),
)
ARMS.add(
    "ur10",
    ArmSpec(
        name="ur10",
        d1=0.1273,
        a2=0.612,
        a3=0.5723,
        d4=0.163941,
        d5=0.1157,
        d6=0.0922,
        shoulder_offset=0.220941,
        elbow_offset=-0.1719,
        link_masses=(7.778, 12.93, 3.87, 1.96, 1.96, 0.202),
        effort_limits=(330.0, 330.0, 150.0, 54.0, 54.0, 54.0),
        velocity_limits=(2.16, 2.16, 3.15, 3.2, 3.2, 3.2),
        payload_kg=10.0,
        shoulder_radius=0.078,
        elbow_radius=0.064,
        wrist_radius=0.047,
        upper_tube_radius=0.062,
        forearm_tube_radius=0.048,
        stiffness=(60000.0, 60000.0, 30000.0, 6000.0, 6000.0, 6000.0),
        lag_s=0.028,
        armature=(9.4, 9.4, 4.7, 0.94, 0.94, 0.94),
    ),
)


def add_arm(
    spec: mujoco.MjSpec, arm: ArmSpec, prefix: str, base: Pose2, colour: str
) -> None:
    """Add an arm with its gripper to a scene.

    Args:
        spec: The scene that is being built, with angles in radians.
        arm: Which arm.
        prefix: Name of the robot; every name in the scene begins with it.
        base: Where it stands on the table.
        colour: ``"red"`` or ``"white"``.

    Raises:
        UnknownNameError: No robot has that colour.
    """
    if colour not in COLOURS:
        raise UnknownNameError("robot colour", colour, COLOURS)
    spec.compiler.degree = False
    half = 0.5 * base.yaw
    body = spec.worldbody.add_body(
        name=f"{prefix}/base",
        pos=[base.x, base.y, 0.0],
        quat=[math.cos(half), 0.0, 0.0, math.sin(half)],
    )
    _dress(body, prefix, "base", _solids(arm)["base"], colour)
    lengths = _dh_rows(arm)
    position, rotation = (0.0, 0.0, 0.0), 0.0
    for index, link in enumerate(LINKS):
        body = body.add_body(
            name=f"{prefix}/{link}",
            pos=list(position),
            quat=[math.cos(0.5 * rotation), math.sin(0.5 * rotation), 0.0, 0.0],
        )
        _add_joint(spec, body, arm, prefix, index)
        solids = _solids(arm)[link]
        _dress(body, prefix, link, solids, colour)
        _weigh(body, arm, index, solids[0])
        d, a, rotation = lengths[index]
        position = (a, 0.0, d)
    add_gripper(spec, body, prefix, arm.d6)
    # Parent and child never collide, except that a fixed base counts as the world.
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
    stiffness = arm.stiffness[index]
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
        biasprm=[0.0, -stiffness, -arm.lag_s * stiffness, *[0.0] * 7],
        ctrllimited=True,
        ctrlrange=[-limit, limit],
        forcelimited=True,
        forcerange=[-effort, effort],
    )


def _solids(arm: ArmSpec) -> dict[str, tuple[Cylinder, ...]]:
    """Return the solids of each link, in its frame, the heaviest first.

    Two housings that meet at a joint form one round solid about its axis, so one
    capsule stands for both.
    """
    side = arm.shoulder_offset
    forearm_side = side + arm.elbow_offset
    shoulder, elbow, wrist = arm.shoulder_radius, arm.elbow_radius, arm.wrist_radius
    return {
        "base": (Cylinder((0, 0, 0), (0, 0, arm.d1), shoulder),),
        # The shoulder turns about the vertical and carries a housing along -y.
        "shoulder": (
            Cylinder(
                (0, 1.1 * shoulder, arm.d1),
                (0, -side - 1.1 * shoulder, arm.d1),
                shoulder,
            ),
        ),
        "upper_arm": (
            Cylinder((0, 0, side), (-arm.a2, 0, side), arm.upper_tube_radius),
            Cylinder(
                (-arm.a2, 0, side + 1.1 * elbow),
                (-arm.a2, 0, forearm_side - 1.1 * elbow),
                elbow,
            ),
        ),
        "forearm": (
            Cylinder(
                (0, 0, forearm_side),
                (-arm.a3, 0, forearm_side),
                arm.forearm_tube_radius,
            ),
        ),
        "wrist_1": (
            Cylinder(
                (0, 0, forearm_side - 1.1 * wrist), (0, 0, arm.d4 + 1.1 * wrist), wrist
            ),
        ),
        "wrist_2": (
            Cylinder((0, 0, -1.1 * wrist), (0, 0, arm.d5 + 1.1 * wrist), wrist),
        ),
        "wrist_3": (Cylinder((0, 0, -1.1 * wrist), (0, 0, arm.d6), wrist),),
    }


def _dress(
    body: mujoco.MjsBody,
    prefix: str,
    link: str,
    solids: tuple[Cylinder, ...],
    colour: str,
) -> None:
    """Add what collides and what is seen."""
    for index, solid in enumerate(solids):
        add_capsule(body, f"{prefix}/{link}_{index}", solid)
        draw_cylinder(body, solid, COLOURS[colour])


def _weigh(body: mujoco.MjsBody, arm: ArmSpec, index: int, solid: Cylinder) -> None:
    """Spread the link's mass over its main solid."""
    mass = arm.link_masses[index]
    across, _, along = cylinder_inertia(mass, solid.radius, solid.length)
    (x0, y0, z0), (x1, y1, z1) = solid.start, solid.end
    centre: Vector = (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1))
    spans = (abs(x1 - x0), abs(y1 - y0), abs(z1 - z0))
    axis = spans.index(max(spans))
    x, y, z = (along if k == axis else across for k in range(3))
    set_inertia(body, mass, centre, (x, y, z))
