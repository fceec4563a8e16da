"""The stick: an L-shaped tool to hook and poke cubes.

Its frame is at the free end of the handle at half height; x points along the handle to
the hook, which bends to +y.
"""

import math

from lemma.core.poses import Pose2
from lemma.scene.objects.kind import (
    OBJECT_KINDS,
    Capsule,
    Grasp,
    ObjectKind,
    Part,
    Shell,
)
from lemma.scene.objects.palette import STICK as STICK_COLOR

HANDLE_LENGTH_M = 0.75
HOOK_LENGTH_M = 0.15
"""Length of the hook, measured from the far side of the handle."""
STICK_SECTION_M = 0.03
STICK_DENSITY = 120.0
"""Density of a foam-filled tube [kg/m3]: friction can hold the stick at one end."""
GRASP_FROM_END_M = 0.05
"""Distance of the grasp from the free end of the handle, for the longest reach."""
STICK_GRASP_HEIGHT_M = 0.018
"""Grasp height above the table; the fingertips are then 6 mm above the table."""

_HALF = STICK_SECTION_M / 2
_AREA = STICK_SECTION_M * STICK_SECTION_M
# The bar starts inside the handle.
_BAR = HOOK_LENGTH_M - STICK_SECTION_M
_END = (0.0, 0.0, 0.0)
_CORNER = (HANDLE_LENGTH_M, 0.0, 0.0)
_TIP = (HANDLE_LENGTH_M, HOOK_LENGTH_M, 0.0)

STICK_KIND = OBJECT_KINDS.add(
    "stick",
    ObjectKind(
        name="stick",
        nouns=("yellow stick", "stick"),
        parts=(
            Part(
                "box",
                (HANDLE_LENGTH_M / 2, _HALF, _HALF),
                STICK_DENSITY * _AREA * HANDLE_LENGTH_M,
                (HANDLE_LENGTH_M / 2, 0.0, 0.0),
                "handle",
            ),
            Part(
                "box",
                (_HALF, _BAR / 2, _HALF),
                STICK_DENSITY * _AREA * _BAR,
                (HANDLE_LENGTH_M - _HALF, _HALF + _BAR / 2, 0.0),
                "hook",
            ),
        ),
        color=STICK_COLOR,
        tool=True,
        height_m=STICK_SECTION_M,
        origin_m=_HALF,
        disc_m=_HALF,
        side_m=_HALF,
        grasp=Grasp(
            STICK_SECTION_M,
            STICK_GRASP_HEIGHT_M,
            math.pi,
            Pose2(GRASP_FROM_END_M, 0.0),
        ),
        obstacle=(Capsule(_END, _CORNER, 0.5 * STICK_SECTION_M),),
        shell=Shell(
            (
                Capsule(_END, _CORNER, 0.8 * STICK_SECTION_M),
                Capsule(_CORNER, _TIP, 0.8 * STICK_SECTION_M),
            ),
            0.5 * STICK_SECTION_M,
        ),
    ),
)
