"""Line: two cubes go through the hands of three robots in a row, as in a factory."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange_line(placer: ObjectPlacer) -> Goal:
    """Cubes are at one end, their pads at the other; the ends share nothing."""
    first, *_, last = placer.order
    pads = [placer.pad(placer.only(last)) for _ in range(2)]
    cubes = [placer.cube(placer.only(first)) for _ in range(2)]
    return Goal(tuple(map(On, cubes, pads)))


TASKS.add(
    "line",
    Task(
        name="line",
        summary="Two cubes go through three robots in a row, onto their pads.",
        subtasks=6,
        distractors=(0, 3),
        arrange=arrange_line,
        layout="row",
        teams=(("ur5", "ur5", "ur5"),),
        language=bank_for("line"),
    ),
)
