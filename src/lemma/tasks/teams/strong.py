"""The family ``strong``: one of three robots has the hand for a heavy cube."""

from lemma.robots.hand import STANDARD, WEAK
from lemma.tasks.goal import Goal, On
from lemma.tasks.library import task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.teams.families import OF_THREE

HEAVY_KG = 2.4
"""Mass of the heavy cube [kg]: of tungsten. A weak hand does not hold it even at rest:
its pads bear 1.96 kg by friction."""


@task(
    "strong",
    "A heavy cube that one of three robots can carry, though others reach it.",
    subtasks=3,
    distractors=(0, 1),
    layout="triangle",
    teams=OF_THREE,
    hands=(STANDARD, WEAK, WEAK),
)
def arrange_strong(placer: ObjectPlacer) -> Goal:
    """The shortest plan by reach gives the heavy cube to a weak hand, or may do so.

    The heavy cube goes onto a light one. Either the strong robot and a weak one reach
    both, and another light cube changes hands between the weak robots. Or the light one
    is where that weak robot alone reaches it, and is brought to the strong one. No
    robot that could touch the heavy cube could touch a pad, over whose rim it would be
    tipped. All three robots are needed.
    """
    strong, weak, other = placer.order
    both = placer.only(strong, weak)
    pad = placer.pad(placer.only(other))
    if placer.choose(2):
        base = placer.cube(both)
        light = placer.cube(placer.only(weak))
    else:
        base = placer.cube(placer.only(weak))
        light = placer.cube(placer.only(other))
    heavy = placer.put("cube", both, mass_kg=HEAVY_KG)
    return Goal((On(heavy, base), On(light, pad)))
