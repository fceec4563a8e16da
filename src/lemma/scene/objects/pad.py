"""The pad: a round plate on the table that supports objects.

It is so high that the stick cannot push a cube onto it. A robot that puts a cube on it
must lift the cube, and so must reach the pad.
"""

import math

from lemma.scene.objects.kind import OBJECT_KINDS, Capsule, ObjectKind, Part, Shell

PAD_RADIUS_M = 0.06
PAD_THICKNESS_M = 0.035

_HALF_M = PAD_THICKNESS_M / 2


def _star(spokes: int) -> tuple[Capsule, ...]:
    """Return capsules that cross at the centre of the plate and cover all of it.

    The points farthest from their axes are on the rim, midway between two capsules.
    """
    half_angle = math.pi / (2 * spokes)
    length = PAD_RADIUS_M * math.cos(half_angle)
    radius = math.hypot(PAD_RADIUS_M * math.sin(half_angle), _HALF_M)
    capsules = []
    for k in range(spokes):
        x = length * math.cos(2 * k * half_angle)
        y = length * math.sin(2 * k * half_angle)
        capsules.append(Capsule((x, y, _HALF_M), (-x, -y, _HALF_M), radius))
    return tuple(capsules)


PAD = OBJECT_KINDS.add(
    "pad",
    ObjectKind(
        name="pad",
        nouns=("pad", "circle", "target"),
        parts=(
            Part("cylinder", (PAD_RADIUS_M, _HALF_M), position_m=(0.0, 0.0, _HALF_M)),
        ),
        fixed=True,
        height_m=PAD_THICKNESS_M,
        origin_m=0.0,
        disc_m=PAD_RADIUS_M,
        side_m=PAD_RADIUS_M,
        spacing_m={"pad": 0.16, "stick": PAD_RADIUS_M + 0.08},
        support_m=PAD_RADIUS_M - 0.01,
        obstacle=(),
        shell=Shell(_star(4), _HALF_M),
    ),
)
