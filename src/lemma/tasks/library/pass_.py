"""Pass: a cube must change sides."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.only(first))
    pad = placer.pad(placer.only(second))
    return Goal((On(cube, pad),))


TASKS.add(
    "pass",
    Task(
        name="pass",
        summary="One robot hands the cube over, the other puts it on its pad.",
        subtasks=2,
        distractors=(0, 4),
        arrange=arrange,
        language=bank_for("pass"),
    ),
)
