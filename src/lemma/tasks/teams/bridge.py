"""The family bridge of the suite ``teams``: a plank on two posts."""

import numpy as np

from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.plank import PLANK_LENGTH_M, PLANK_SPAN_M
from lemma.tasks.goal import Goal, On
from lemma.tasks.library import task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.teams.families import OF_THREE
from lemma.tasks.zones import Mask, Zone

SPAN_SLACK_M = 0.008
"""How much nearer or farther than the plank spans the two pads may be."""


@task(
    "bridge",
    "Two robots bring a post each, and a third lays the plank across both.",
    subtasks=3,
    distractors=(0, 1),
    layout="triangle",
    kinds=("plank",),
    teams=OF_THREE,
)
def arrange_bridge(placer: ObjectPlacer) -> Goal:
    """Each robot alone has a post or the plank; all reach the pads of the posts.

    Nobody gets at another one's post, not even with the plank in the hand.
    """
    *owners, layer = placer.order
    everybody = placer.only(*placer.order)
    pads = [placer.pad(everybody)]
    pads.append(placer.pad(_so_far_from(placer, pads[0], everybody)))
    posts = [placer.cube(placer.only(r, beyond_m=PLANK_LENGTH_M)) for r in owners]
    plank = placer.put("plank", placer.only(layer))
    stands = map(On, posts, pads)
    return Goal((*stands, *(On(plank, post) for post in posts)))


def _so_far_from(placer: ObjectPlacer, name: str, zone: Zone) -> Zone:
    """Return the part of a zone from where the plank spans to an object."""
    at: Pose2 = next(p.pose for p in placer.objects if p.name == name)

    def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
        away_m = np.sqrt((x - at.x) ** 2 + (y - at.y) ** 2)
        near: Mask = np.abs(away_m - PLANK_SPAN_M) <= SPAN_SLACK_M
        return near & zone.sift(kind, x, y)

    says = f"{zone.says}, {100 * PLANK_SPAN_M:.0f} cm from the pad of the other post"
    return Zone(sift, barred=zone.barred, tool=zone.tool, says=says)
