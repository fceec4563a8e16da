"""Hook: a cube that nobody reaches is dragged closer with the stick."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.tool_only(Primitive.HOOK, first, second))
    # Out of the first robot's way even with the stick: it cannot carry a cube there.
    pad = placer.pad(placer.only(second, tool=True))
    placer.stick(first)
    return Goal((On(cube, pad),))


TASKS.add(
    "hook",
    Task(
        name="hook",
        summary="One robot hooks the cube and hands it over, the other has its pad.",
        subtasks=4,
        distractors=(0, 2),
        arrange=arrange,
        language=bank_for("hook"),
    ),
)
