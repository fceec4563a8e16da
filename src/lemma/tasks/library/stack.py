"""Stack: the robots meet in the middle to build a tower."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    bottom = placer.cube(placer.only(first))
    top = placer.cube(placer.only(second))
    return Goal((On(top, bottom),))


TASKS.add(
    "stack",
    Task(
        name="stack",
        summary="One robot brings the lower cube, the other puts its own on top.",
        subtasks=2,
        distractors=(0, 3),
        arrange=arrange,
        language=bank_for("stack"),
    ),
)
