"""The tray, which two robots carry together, and the rack on which it is put.

The tray is too wide for a gripper, and has a handle at either end. A hand that raises
one handle alone leaves the other end on the table: the weight turns the handle in its
fingers. A rack is a pair of posts, one under the end of either handle, so that no end
of the tray hangs over a post and nobody can tip it by a push from above.
"""

import math

from lemma.core.poses import Pose2
from lemma.scene.objects.kind import (
    OBJECT_KINDS,
    Capsule,
    Carried,
    Grasp,
    ObjectKind,
    Part,
    Shell,
)

TRAY_LENGTH_M = 0.80
TRAY_WIDTH_M = 0.14
"""More than the fingers open."""
TRAY_HEIGHT_M = 0.03
TRAY_MASS_KG = 4.0
PLATE_LENGTH_M = 0.60
"""Length of the part between the handles."""
HANDLE_WIDTH_M = 0.03
HANDLE_GRASP_M = 0.335
"""From the middle to where each hand grasps, along x."""
REST_M = 0.38
"""From the middle to the middle of each post under it, along x."""
RACK_HEIGHT_M = 0.06

_HALF_M = TRAY_HEIGHT_M / 2
_HANDLE_HALF_M = (TRAY_LENGTH_M - PLATE_LENGTH_M) / 4
_HANDLE_M = PLATE_LENGTH_M / 2 + _HANDLE_HALF_M
_HANDLE_KG = 0.1 * TRAY_MASS_KG
_GRASP_HEIGHT_M = 0.018
"""The fingertips end 6 mm above the table, so they never touch it."""
_POST_HALF_M = (0.016, 0.03)
_DISC_M = math.hypot(TRAY_LENGTH_M / 2, HANDLE_WIDTH_M / 2)
_ROW_M = 0.16
"""Between the middles of trays and racks that lie side by side, at least."""


def _handle(side: float) -> Part:
    return Part(
        "box",
        (_HANDLE_HALF_M, HANDLE_WIDTH_M / 2, _HALF_M),
        _HANDLE_KG,
        (side * _HANDLE_M, 0.0, 0.0),
        "left" if side < 0.0 else "right",
    )


def _grip(side: float) -> Grasp:
    at = Pose2(side * HANDLE_GRASP_M, 0.0)
    return Grasp(HANDLE_WIDTH_M, _GRASP_HEIGHT_M, math.pi, at)


_SPINE = Capsule(
    (-TRAY_LENGTH_M / 2, 0.0, 0.0), (TRAY_LENGTH_M / 2, 0.0, 0.0), TRAY_WIDTH_M / 2
)

TRAY = OBJECT_KINDS.add(
    "tray",
    ObjectKind(
        name="tray",
        nouns=("tray",),
        parts=(
            Part(
                "box",
                (PLATE_LENGTH_M / 2, TRAY_WIDTH_M / 2, _HALF_M),
                TRAY_MASS_KG - 2.0 * _HANDLE_KG,
                name="plate",
            ),
            _handle(-1.0),
            _handle(1.0),
        ),
        color=(0.55, 0.36, 0.20, 1.0),
        listed=False,
        height_m=TRAY_HEIGHT_M,
        origin_m=_HALF_M,
        disc_m=_DISC_M,
        side_m=_DISC_M,
        spacing_m={"rack": _ROW_M},
        carried=Carried((_grip(-1.0), _grip(1.0)), REST_M),
        support_m=0.15,
        obstacle=(
            Capsule(
                (-TRAY_LENGTH_M / 2, 0.0, 0.0), (TRAY_LENGTH_M / 2, 0.0, 0.0), 0.03
            ),
        ),
        shell=Shell((_SPINE,), _HALF_M),
    ),
)


def _post(side: float) -> Part:
    half = (*_POST_HALF_M, RACK_HEIGHT_M / 2)
    at = (side * REST_M, 0.0, RACK_HEIGHT_M / 2)
    return Part("box", half, None, at, "left" if side < 0.0 else "right")


def _post_capsule(side: float) -> Capsule:
    x, radius = side * REST_M, math.hypot(*_POST_HALF_M)
    return Capsule((x, 0.0, 0.0), (x, 0.0, RACK_HEIGHT_M - radius), radius)


RACK = OBJECT_KINDS.add(
    "rack",
    ObjectKind(
        name="rack",
        nouns=("rack",),
        parts=(_post(-1.0), _post(1.0)),
        listed=False,
        fixed=True,
        height_m=RACK_HEIGHT_M,
        origin_m=0.0,
        disc_m=REST_M + _POST_HALF_M[0],
        side_m=REST_M + _POST_HALF_M[0],
        spacing_m={"rack": _ROW_M},
        support_m=0.012,
        obstacle=(_post_capsule(-1.0), _post_capsule(1.0)),
        shell=Shell(
            (_post_capsule(-1.0), _post_capsule(1.0)), math.hypot(*_POST_HALF_M)
        ),
    ),
)
