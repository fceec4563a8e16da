"""Tower: three cubes of three owners, on one pad of the first."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange_tower(placer: ObjectPlacer) -> Goal:
    """The first robot has the pad and the lowest cube, the others one cube each."""
    builder = placer.order[0]
    pad = placer.pad(placer.only(builder))
    low, middle, high = (placer.cube(placer.only(robot)) for robot in placer.order)
    return Goal((On(low, pad), On(middle, low), On(high, middle)))


TASKS.add(
    "tower",
    Task(
        name="tower",
        summary="Three robots bring a cube each to a tower that one of them builds.",
        subtasks=5,
        distractors=(0, 2),
        arrange=arrange_tower,
        layout="triangle",
        teams=(
            ("ur5",) * 3,
            ("ur5", "ur5", "ur10"),
            ("ur5", "ur10", "ur10"),
            ("ur10",) * 3,
        ),
        language=bank_for("tower"),
    ),
)
