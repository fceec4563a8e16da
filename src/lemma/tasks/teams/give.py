"""The family *give*: a rod that goes through the air from one hand to another.

The robots stand at a gap in the table, so wide that a rod falls into it and nobody
could touch a rod on the other one's table top. Both hands get to either end of a rod
that is held out over the gap.
"""

from collections.abc import Sequence

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
    """Where the giver works at one end of a rod, and no other robot could touch it.

    Both ends are in view of a camera and on the map.
    """
    assert ROD.ends is not None
    half_m, only = 0.5 * ROD_LENGTH_M, placer.only(giver)
    grips = [grasp.at for grasp in ROD.ends]
    tips = [Pose2(-half_m, 0.0), Pose2(half_m, 0.0)]

    def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
        return only.sift(kind, x, y)

    def check(pose: Pose2) -> bool:
        works = placer.territory.works(giver, *_places(pose, grips)).any()
        return bool(works and placer.territory.in_view(*_places(pose, tips)).all())

    says = (
        "in view and where the {%d} works at one end, and no other robot could do "
        "anything"
    )
    return Zone(sift, check, only.barred, says=says % giver)


def _places(pose: Pose2, local: Sequence[Pose2]) -> tuple[FloatArray, FloatArray]:
    """Return x and y of points of a rod, (n,) each [m]."""
    x, y = zip(*((pose @ at).xy for at in local), strict=True)
    return np.array(x), np.array(y)
