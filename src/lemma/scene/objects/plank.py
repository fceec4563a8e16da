"""The plank: a bar that is laid across two things of the same height, as a bridge.

Its frame is in its middle; x points along it. It is held in its middle, across.
"""

import math

from lemma.scene.objects.kind import OBJECT_KINDS, Capsule, Grasp, Shell, box

PLANK_LENGTH_M = 0.26
PLANK_WIDTH_M = 0.04
PLANK_THICKNESS_M = 0.03
PLANK_SPAN_M = 0.18
"""Between the middles of the two things that it lies across."""
PLANK_MASS_KG = 0.15
"""Of 480 kg/m3, pine."""
_GRASP_HEIGHT_M = 0.018
"""The fingertips end 6 mm above what it lies on."""

_HALF_M = PLANK_LENGTH_M / 2
_INNER_M = _HALF_M - PLANK_WIDTH_M / 2

PLANK = OBJECT_KINDS.add(
    "plank",
    box(
        "plank",
        (PLANK_LENGTH_M, PLANK_WIDTH_M, PLANK_THICKNESS_M),
        PLANK_MASS_KG,
        color=(0.62, 0.42, 0.22, 1.0),
        grasp=Grasp(PLANK_WIDTH_M, _GRASP_HEIGHT_M, math.pi),
        tops=((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)),
        support_m=None,
        obstacle=(
            Capsule((-_INNER_M, 0.0, 0.0), (_INNER_M, 0.0, 0.0), PLANK_WIDTH_M / 2),
        ),
        shell=Shell(
            (
                Capsule(
                    (-_HALF_M, 0.0, 0.0),
                    (_HALF_M, 0.0, 0.0),
                    math.hypot(PLANK_WIDTH_M / 2, PLANK_THICKNESS_M / 2),
                ),
            ),
            PLANK_THICKNESS_M / 2,
        ),
        listed=False,
        span_m=PLANK_SPAN_M,
    ),
)
