"""Stack2: two towers, each built by both robots."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    bottom_1 = placer.cube(placer.only(first))
    top_1 = placer.cube(placer.only(second))
    bottom_2 = placer.cube(placer.only(second))
    top_2 = placer.cube(placer.only(first))
    return Goal((On(top_1, bottom_1), On(top_2, bottom_2)))


TASKS.add(
    "stack2",
    Task(
        name="stack2",
        summary="Two towers, each of one cube from either side.",
        subtasks=4,
        distractors=(0, 2),
        arrange=arrange,
        language=bank_for("stack2"),
    ),
)
