"""How a UR arm looks: joint housings with lids, tubes between them, a flange.

Each joint is a motor housing, closed by a rounded lid, that meets the next link at a
dark seam; tubes and the next housing leave it at right angles. Drawn once per arm type
from the numbers of the arm.
"""

from functools import lru_cache

from lemma.robots.ur.arms import ArmSpec
from lemma.robots.ur.lofts import Loft, Surface, Vector, mesh, rounded

LID = 1.1
"""How far housings reach beyond the axis that crosses them, in radii."""

_EDGE = 0.35
"""Radius of the lids' edges, in radii of the housing."""
_INSET = 0.985
"""Radius of lids and seams, in the same unit: they lie just inside a shell."""
_SEAM_M = 0.006
_ORIGIN: Vector = (0, 0, 0)
_Z: Vector = (0, 0, 1)

Look = dict[str, Surface]
"""The meshes of one link by what they are made of: shell, dark, lid or metal."""


@lru_cache
def looks(arm: ArmSpec) -> dict[str, Look]:
    """Return what is seen of each link, in its frame."""
    return {
        "base": _base(arm),
        "shoulder": _shoulder(arm),
        "upper_arm": _upper_arm(arm),
        "forearm": _forearm(arm),
        "wrist_1": _wrist(arm, arm.d4, (0, -1, 0), _wrist_seam(arm), arm.d5),
        "wrist_2": _wrist(arm, arm.d5, (0, 1, 0), 0.5 * arm.d5, arm.d6),
        "wrist_3": _flange(arm),
    }


def _base(arm: ArmSpec) -> Look:
    radius = arm.shoulder_radius
    plate, top = 0.2 * radius, _base_top(arm)
    foot = ((0.0, 1.25 * radius), (plate, 1.25 * radius), (plate, radius))
    column = ((plate, radius), (top - _SEAM_M, radius))
    seam = ((top - _SEAM_M, _INSET * radius), (top, _INSET * radius))
    return {
        "dark": mesh([Loft(_ORIGIN, _Z, foot), Loft(_ORIGIN, _Z, seam)]),
        "shell": mesh([Loft(_ORIGIN, _Z, column)]),
    }


def _shoulder(arm: ArmSpec) -> Look:
    radius = arm.shoulder_radius
    stub = ((_base_top(arm), radius), (arm.d1, radius))
    look = _motor((0, 0, arm.d1), (0, -1, 0), radius, 0.5 * arm.shoulder_offset)
    look["shell"].append(Loft(_ORIGIN, _Z, stub))
    return _meshes(look)


def _upper_arm(arm: ArmSpec) -> Look:
    side, near, far = arm.shoulder_offset, arm.shoulder_radius, arm.elbow_radius
    # The elbow's motor turns its lid away from the base, its seam towards the middle.
    look = _motor((-arm.a2, 0, side), (0, 0, -1), far, -0.5 * arm.elbow_offset)
    end = rounded(0.5 * side, side + LID * near, near, _EDGE * near)
    look["shell"].append(Loft(_ORIGIN, _Z, end, closed=(False, True)))
    _add_tube(look, (0, 0, side), (near, far), arm.upper_tube_radius, arm.a2)
    return _meshes(look)


def _forearm(arm: ArmSpec) -> Look:
    side = arm.shoulder_offset + arm.elbow_offset
    near, far = arm.elbow_radius, arm.wrist_radius
    look = _motor((-arm.a3, 0, side), _Z, far, _wrist_seam(arm) - side)
    end = rounded(0.5 * arm.elbow_offset, LID * near, near, _EDGE * near)
    look["shell"].append(Loft((0, 0, side), (0, 0, -1), end, closed=(False, True)))
    _add_tube(look, (0, 0, side), (near, far), arm.forearm_tube_radius, arm.a3)
    return _meshes(look)


def _wrist(
    arm: ArmSpec, height: float, axis: Vector, seam: float, length: float
) -> Look:
    """Return a wrist: a stub from the last seam and a motor across it."""
    radius = arm.wrist_radius
    look = _motor((0, 0, height), axis, radius, 0.5 * length)
    look["shell"].append(Loft(_ORIGIN, _Z, ((seam, radius), (height, radius))))
    return _meshes(look)


def _flange(arm: ArmSpec) -> Look:
    profile = rounded(0.5 * arm.d6, arm.d6, arm.wrist_radius, 0.1 * arm.wrist_radius)
    return {"metal": mesh([Loft(_ORIGIN, _Z, profile, closed=(False, True))])}


def _motor(
    centre: Vector, axis: Vector, radius: float, seam: float
) -> dict[str, list[Loft]]:
    """Return a motor housing from its lid to the seam where the next link turns.

    Args:
        centre: Where the housing's axis meets that of its own link [m].
        axis: From the lid to the seam.
        radius: Radius of the housing [m].
        seam: Where the housing ends, along the axis from the centre [m].
    """
    x, y, z = axis
    split = (LID - 0.45) * radius
    lid = rounded(split - _SEAM_M, LID * radius, _INSET * radius, _EDGE * radius)
    shell = ((-split, radius), (seam - _SEAM_M, radius))
    ring = ((seam - _SEAM_M, _INSET * radius), (seam, _INSET * radius))
    return {
        "lid": [Loft(centre, (-x, -y, -z), lid, closed=(False, True))],
        "shell": [Loft(centre, axis, shell)],
        "dark": [Loft(centre, axis, ring)],
    }


def _add_tube(
    look: dict[str, list[Loft]],
    origin: Vector,
    housings: tuple[float, float],
    radius: float,
    length: float,
) -> None:
    """Add the tube between two housings, with a collar at each end."""
    near, far = 1.08 * housings[0], length - 1.08 * housings[1]
    width = 0.2 * radius
    along: Vector = (-1, 0, 0)
    tube = ((0.0, radius), (length, radius))
    look["shell"].append(Loft(origin, along, tube))
    for start in (near, far - width):
        ring = ((start, 1.035 * radius), (start + width, 1.035 * radius))
        look["dark"].append(Loft(origin, along, ring))


def _base_top(arm: ArmSpec) -> float:
    """Return the height of the seam between base and shoulder [m]."""
    return 0.42 * arm.d1


def _wrist_seam(arm: ArmSpec) -> float:
    """Return where forearm and wrist 1 meet along the axis of wrist 1 [m]."""
    return 0.5 * (arm.shoulder_offset + arm.elbow_offset + arm.d4)


def _meshes(look: dict[str, list[Loft]]) -> Look:
    return {material: mesh(lofts) for material, lofts in look.items()}
