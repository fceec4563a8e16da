"""A two-finger parallel gripper, similar to a Hand-E, with a longer stroke.

Both fingers are one degree of freedom: a servo drives their summed travel, which is
the opening width, and an equality constraint keeps them symmetric. Objects are held by
friction alone, never by weld constraints.
"""

from functools import lru_cache

from lemma.core.engine import mujoco
from lemma.robots.geometry import (
    DARK,
    METAL,
    Box,
    Rgba,
    add_box,
    box_inertia,
    draw,
    set_inertia,
)
from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGER_WIDTH_M,
    FINGERTIP_BEYOND_TCP_M,
    MASS_KG,
    PALM_BEYOND_FLANGE_M,
    SKIN_M,
    TCP_OFFSET_M,
)
from lemma.robots.hand import (
    HANDS,
    RUBBER_FRICTION,
    RUBBER_SOLIMP,
    RUBBER_SOLREF,
    STANDARD,
)
from lemma.robots.ur.meshes import Loft, Surface, mesh

_FINGER_MASS_KG = 0.1
# Speed of the width at full force: the full stroke takes 0.5 s.
_CLOSING_M_S = 0.2
# Reflected inertia of the screw drive; it also improves the numerical conditioning.
_FINGER_ARMATURE = 5.0
_SERVO_STIFFNESS = 5000.0
_PALM = Box((0.0, 0.0, 0.051), (0.060, 0.112, 0.042))
_ORANGE: Rgba = (0.93, 0.49, 0.08, 1.0)
"""Palm of a hand that is not the standard one."""


def add_gripper(
    spec: mujoco.MjSpec,
    parent: mujoco.MjsBody,
    prefix: str,
    flange_z_m: float,
    hand: str = STANDARD,
) -> mujoco.MjsBody:
    """Add a gripper to the last link of an arm.

    Args:
        spec: The MuJoCo specification of the scene.
        parent: The last link; its z axis points out of the flange.
        prefix: Name of the robot.
        flange_z_m: Height of the flange in the frame of ``parent`` [m].
        hand: A name in :data:`~lemma.robots.hand.HANDS`. Any but the standard one has
            an orange palm.

    Returns:
        The body ``<prefix>/gripper``, whose frame is that of the flange.
    """
    palm = parent.add_body(name=f"{prefix}/gripper", pos=[0, 0, flange_z_m])
    palm_mass = MASS_KG - 2.0 * _FINGER_MASS_KG
    set_inertia(palm, palm_mass, (0, 0, 0.04), box_inertia(palm_mass, _PALM.size))
    add_box(palm, f"{prefix}/palm", _PALM)
    paints = {"coupling": METAL, "palm": DARK if hand == STANDARD else _ORANGE}
    for part, paint in paints.items():
        draw(spec, palm, f"gripper/{part}", _looks()[part], paint)
    palm.add_site(
        name=f"{prefix}/tcp", pos=[0, 0, TCP_OFFSET_M], size=[0.005] * 3, group=4
    )
    _add_finger(spec, palm, prefix, "left", 1.0)
    _add_finger(spec, palm, prefix, "right", -1.0)
    _couple_fingers(spec, prefix, HANDS[hand].force_n)
    return palm


def _add_finger(
    spec: mujoco.MjSpec,
    palm: mujoco.MjsBody,
    prefix: str,
    side: str,
    direction: float,
) -> None:
    """Add one finger; joint position zero is closed."""
    name = f"{prefix}/finger_{side}"
    finger = palm.add_body(name=name, pos=[0, 0, TCP_OFFSET_M])
    top = PALM_BEYOND_FLANGE_M - TCP_OFFSET_M
    tip = FINGERTIP_BEYOND_TCP_M
    width, thickness = FINGER_WIDTH_M, FINGER_THICKNESS_M
    centre_y = direction * 0.5 * thickness
    pad = Box((0, centre_y, 0), (width, thickness, 2.0 * tip))
    # The stem is recessed, so that only the pad touches a held object.
    recess = 0.003
    stem = Box(
        (0, centre_y + direction * 0.5 * recess, 0.5 * (top - tip)),
        (width, thickness - recess, -tip - top),
    )
    inertia = box_inertia(_FINGER_MASS_KG, (width, thickness, tip - top))
    set_inertia(finger, _FINGER_MASS_KG, (0, centre_y, 0.5 * (top + tip)), inertia)
    finger.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, direction, 0],
        limited=True,
        range=[0.0, 0.5 * FINGER_OPENING_M],
        armature=_FINGER_ARMATURE,
    )
    _make_rubber(add_box(finger, f"{prefix}/pad_{side}", pad))
    add_box(finger, f"{name}_stem", stem)
    for part, paint in (("pad", DARK), ("stem", METAL)):
        draw(spec, finger, f"gripper/{part}_{side}", _looks()[f"{part}_{side}"], paint)


def _make_rubber(pad: mujoco.MjsGeom) -> None:
    """Set the contact parameters of a pad; they override those of objects."""
    pad.priority = 1
    pad.condim = 4
    pad.friction = RUBBER_FRICTION
    # Stiffness and damping of the contact [1/s2, 1/s]. Friction stops slip by damping
    # alone. In an arm that moves on a curve, a held object drifts by
    # (1 / damping - h / 2) times the centripetal acceleration, with h the time step.
    # At h = 5 ms, a damping of 280 has two fifths of the drift of the usual 200; from
    # about 320 the fingers bounce.
    pad.solref = RUBBER_SOLREF
    # Constant, high impedance: lower values let a loaded object creep.
    pad.solimp = RUBBER_SOLIMP
    pad.margin = SKIN_M


def _couple_fingers(spec: mujoco.MjSpec, prefix: str, force_n: float) -> None:
    """Drive the opening width by one servo and keep the fingers symmetric."""
    left, right = f"{prefix}/finger_left", f"{prefix}/finger_right"
    damping = force_n / _CLOSING_M_S
    width = spec.add_tendon(name=f"{prefix}/width", damping=[damping, 0, 0])
    width.wrap_joint(left, 1.0)
    width.wrap_joint(right, 1.0)
    coupling = spec.add_equality(
        name=f"{prefix}/fingers",
        type=mujoco.mjtEq.mjEQ_JOINT,
        name1=left,
        name2=right,
        solref=[0.01, 1.0],
        solimp=[0.99, 0.9999, 0.001, 0.5, 2.0],
    )
    coupling.data[:5] = [0, 1, 0, 0, 0]
    spec.add_actuator(
        name=f"{prefix}/gripper",
        target=width.name,
        trntype=mujoco.mjtTrn.mjTRN_TENDON,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[_SERVO_STIFFNESS, *[0.0] * 9],
        biasprm=[0.0, -_SERVO_STIFFNESS, *[0.0] * 8],
        ctrllimited=True,
        ctrlrange=[0.0, FINGER_OPENING_M],
        forcelimited=True,
        forcerange=[-force_n, force_n],
    )
    spec.add_exclude(bodyname1=left, bodyname2=right)


@lru_cache
def _looks() -> dict[str, Surface]:
    """Return the visible meshes of the gripper, each in the frame of its body."""
    up = (0.0, 0.0, 1.0)
    palm_z, (palm_x, palm_y, palm_height) = _PALM.centre[2], _PALM.size
    low, high = palm_z - 0.5 * palm_height, palm_z + 0.5 * palm_height
    corner = 0.014
    flat = (0.5 * palm_x - corner, 0.5 * palm_y - corner)
    bevel = 0.005
    coupling = ((0.0, 0.034), (low, 0.034))
    palm = (
        (low, corner - bevel),
        (low + bevel, corner),
        (high - bevel, corner),
        (high, corner - bevel),
    )
    result = {
        "coupling": mesh([Loft((0, 0, 0), up, coupling)]),
        "palm": mesh([Loft((0, 0, 0), up, palm, 8, (True, True), flat)]),
    }
    top, tip = PALM_BEYOND_FLANGE_M - TCP_OFFSET_M, FINGERTIP_BEYOND_TCP_M
    edge = 0.003
    for side, direction in (("left", 1.0), ("right", -1.0)):
        rubber, back = 0.004, FINGER_THICKNESS_M
        # The pad is drawn with its contact margin; else held objects seem to float.
        inner = (rubber + SKIN_M) / 2
        pad_flat = (0.5 * FINGER_WIDTH_M - edge / 3, inner - edge / 3)
        pad = Loft(
            (0, direction * (inner - SKIN_M), 0),
            up,
            ((-tip, edge / 3), (tip, edge / 3)),
            4,
            (True, True),
            pad_flat,
        )
        stem_flat = (0.5 * FINGER_WIDTH_M - edge, 0.5 * (back - rubber) - edge)
        stem = Loft(
            (0, direction * 0.5 * (back + rubber), 0),
            up,
            ((top, edge), (tip - 0.004, edge), (tip, edge / 2)),
            4,
            (False, True),
            stem_flat,
        )
        result[f"pad_{side}"] = mesh([pad])
        result[f"stem_{side}"] = mesh([stem])
    return result
