"""The rod, which one robot hands to another one in the air.

Its frame is in its middle; x points along it. A hand holds it near either end, so that
two hands have room, or across its middle to move it.
"""

import math

from lemma.core.poses import Pose2
from lemma.scene.objects.kind import OBJECT_KINDS, Capsule, Grasp, Shell, box

ROD_LENGTH_M = 0.32
ROD_WIDTH_M = 0.03
ROD_MASS_KG = 0.12
END_GRASP_M = 0.125
"""From the middle to where each hand grasps, along x: hands are 25 cm apart."""
_GRASP_HEIGHT_M = 0.018
"""The fingertips end 6 mm above what it lies on."""

_HALF_M = ROD_LENGTH_M / 2
_INNER_M = _HALF_M - ROD_WIDTH_M / 2


def _grip(side: float) -> Grasp:
    at = Pose2(side * END_GRASP_M, 0.0)
    return Grasp(ROD_WIDTH_M, _GRASP_HEIGHT_M, math.pi, at)


ROD = OBJECT_KINDS.add(
    "rod",
    box(
        "rod",
        (ROD_LENGTH_M, ROD_WIDTH_M, ROD_WIDTH_M),
        ROD_MASS_KG,
        color=(0.20, 0.50, 0.55, 1.0),
        grasp=Grasp(ROD_WIDTH_M, _GRASP_HEIGHT_M, math.pi),
        ends=(_grip(-1.0), _grip(1.0)),
        tops=((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)),
        support_m=None,
        obstacle=(
            Capsule((-_INNER_M, 0.0, 0.0), (_INNER_M, 0.0, 0.0), ROD_WIDTH_M / 2),
        ),
        shell=Shell(
            (
                Capsule(
                    (-_HALF_M, 0.0, 0.0),
                    (_HALF_M, 0.0, 0.0),
                    math.hypot(ROD_WIDTH_M / 2, ROD_WIDTH_M / 2),
                ),
            ),
            ROD_WIDTH_M / 2,
        ),
        listed=False,
    ),
)
