"""Pass2: two cubes cross the table in opposite directions."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    cube_1 = placer.cube(placer.only(first))
    pad_1 = placer.pad(placer.only(second))
    cube_2 = placer.cube(placer.only(second))
    pad_2 = placer.pad(placer.only(first))
    return Goal((On(cube_1, pad_1), On(cube_2, pad_2)))


TASKS.add(
    "pass2",
    Task(
        name="pass2",
        summary="Two cubes change sides, in opposite directions.",
        subtasks=4,
        distractors=(0, 4),
        arrange=arrange,
        language=bank_for("pass2"),
    ),
)
