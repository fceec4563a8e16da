"""The family *unison*: two cubes are laid down at the same time.

One cube has to change hands before, the other one has not. So whoever begins at once
is too early with the other one.
"""

from lemma.tasks.goal import Goal, On
from lemma.tasks.library import task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.teams.families import OF_THREE
from lemma.tasks.teams.rule import Together


@task(
    "unison",
    "Two robots lay a cube each on its pad at the same time; one cube is handed over.",
    subtasks=3,
    distractors=(0, 1),
    layout="triangle",
    teams=OF_THREE,
    rules=(Together.kind,),
)
def arrange_unison(placer: ObjectPlacer) -> Goal:
    """One cube lies with a robot that does not reach its pad, the other is its owner's.

    Which of the two the goal names first is drawn.
    """
    giver, taker, alone = placer.order
    pads = [placer.pad(placer.only(robot)) for robot in (taker, alone)]
    cubes = [placer.cube(placer.only(robot)) for robot in (giver, alone)]
    pairs = list(zip(cubes, pads, strict=True))
    first = placer.choose(2)
    one, other = pairs[first], pairs[1 - first]
    return Goal((On(*one), On(*other)), Together(*one, *other))
