"""The family ``strong``: one of three robots has the hand for a heavy cube."""

from lemma.robots.hand import STANDARD, WEAK
from lemma.tasks.goal import Goal, On
from lemma.tasks.library import task
from lemma.tasks.placement import ObjectPlacer

HEAVY_KG = 2.4
"""Mass of the heavy cube [kg]: of tungsten. A weak hand does not hold it even at rest:
its pads bear 1.96 kg by friction."""


@task(
    "strong",
    "A heavy cube that one of three robots can carry, though others reach it.",
    subtasks=3,
    distractors=(0, 1),
    layout="triangle",
    teams=(
        ("ur5",) * 3,
        ("ur5", "ur5", "ur10"),
        ("ur5", "ur10", "ur10"),
        ("ur10",) * 3,
    ),
    hands=(STANDARD, WEAK, WEAK),
)
def arrange_strong(placer: ObjectPlacer) -> Goal:
    """The shortest plan by reach gives the heavy cube to a weak hand, or may do so.

    Either the heavy cube and its pad lie where the strong robot reaches them and
    another one does, and a light cube changes hands between the others. Or it goes onto
    a light cube of a weak robot, which reaches both, and the strong one only the heavy
    cube: the light one is brought to it. All three robots are needed in both.
    """
    strong, one, other = placer.order
    if placer.choose(2):
        pad = placer.pad(placer.only(other))
        light = placer.cube(placer.only(one))
        both = placer.only(strong, (one, other)[placer.choose(2)])
        target = placer.pad(both)
        heavy = placer.put("cube", both, mass_kg=HEAVY_KG)
        return Goal((On(heavy, target), On(light, pad)))
    base = placer.cube(placer.only(one))
    pad = placer.pad(placer.only(one, other))
    light = placer.cube(placer.only(other))
    heavy = placer.put("cube", placer.only(strong, one), mass_kg=HEAVY_KG)
    return Goal((On(heavy, base), On(light, pad)))
