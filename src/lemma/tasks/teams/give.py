"""The family *give*: a rod that goes through the air from one hand to another.

The robots stand at a gap in the table, so wide that a rod falls into it and nobody
could touch a rod on the other one's table top. Both hands get to either end of a rod
that is held out over the gap.
"""

import numpy as np

from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.rod import ROD, ROD_LENGTH_M
from lemma.tasks.goal import Goal, On
from lemma.tasks.library import task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TEAMS
from lemma.tasks.zones import Mask, Zone


@task(
    "give",
    "One robot gives a rod across a gap to the other, who puts it on a pad.",
    subtasks=1,
    distractors=(0, 3),
    layout="gap_pair",
    kinds=("rod",),
    teams=TEAMS,
)
def arrange_give(placer: ObjectPlacer) -> Goal:
    """The giver alone reaches the rod; the taker alone gets one onto either pad.

    A hand that holds the rod by its end does not bring it to a pad.
    """
    giver, taker = placer.order[:2]
    far = placer.only(taker, beyond_m=0.5 * ROD_LENGTH_M)
    pad = placer.pad(far)
    placer.pad(far)
    rod = placer.put("rod", _at_an_end(placer, giver))
    return Goal((On(rod, pad),))


def _at_an_end(placer: ObjectPlacer, giver: int) -> Zone:
    """Where the giver works at one end of a rod, and no other robot could touch it."""
    assert ROD.ends is not None
    ends, only = ROD.ends, placer.only(giver)

    def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
        return only.sift(kind, x, y)

    def check(pose: Pose2) -> bool:
        hands = [pose @ grasp.at for grasp in ends]
        x, y = (np.array([getattr(at, axis) for at in hands]) for axis in ("x", "y"))
        return bool(placer.territory.works(giver, x, y).any())

    says = "where the {%d} works at one end, and no other robot could do anything"
    return Zone(sift, check, only.barred, says=says % giver)
