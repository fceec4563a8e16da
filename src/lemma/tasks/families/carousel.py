"""Carousel: four robots at the corners of a square, and everybody passes on."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange_carousel(placer: ObjectPlacer) -> Goal:
    """Each robot has a cube, whose pad is with the next one around the square."""
    order = placer.order
    cubes = [placer.cube(placer.only(robot)) for robot in order]
    pads = [placer.pad(placer.only(robot)) for robot in (*order[1:], order[0])]
    return Goal(tuple(map(On, cubes, pads)))


TASKS.add(
    "carousel",
    Task(
        name="carousel",
        summary="Each of four robots passes its cube on to the next, onto its pad.",
        subtasks=8,
        distractors=(0, 1),
        arrange=arrange_carousel,
        layout="square",
        teams=(("ur5",) * 4, ("ur5", "ur10", "ur5", "ur10")),
        language=bank_for("carousel"),
    ),
)
