"""The cube, which robots move, stack, hook and poke."""

from lemma.scene.objects.kind import OBJECT_KINDS, Capsule, Shell, box

CUBE_EDGE_M = 0.05
CUBE_MASS_KG = 0.09
"""Mass of a wooden cube of 720 kg/m3."""

_MIDDLE = (0.0, 0.0, 0.0)

CUBE = OBJECT_KINDS.add(
    "cube",
    box(
        "cube",
        (CUBE_EDGE_M, CUBE_EDGE_M, CUBE_EDGE_M),
        CUBE_MASS_KG,
        nouns=("cube", "block", "box"),
        disc_m=0.036,
        side_m=0.028,
        spacing_m={"cube": 0.125, "pad": 0.15, "stick": 0.10},
        drag_m=CUBE_EDGE_M / 2,
        # The sphere around it is wider than its footprint at any heading.
        shell=Shell(
            (Capsule(_MIDDLE, _MIDDLE, 0.87 * CUBE_EDGE_M),), 0.5 * CUBE_EDGE_M
        ),
    ),
)
