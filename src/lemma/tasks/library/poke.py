"""Poke: a cube that nobody reaches is pushed over with the stick."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    # Out of the first robot's way even with the stick: a raised one can push a cube up.
    pad = placer.pad(placer.only(second, tool=True))
    placer.stick(first)
    return Goal((On(cube, pad),))


TASKS.add(
    "poke",
    Task(
        name="poke",
        summary="One robot pokes the cube over, the other puts it on its pad.",
        subtasks=3,
        distractors=(0, 3),
        arrange=arrange,
        language=bank_for("poke"),
        apart=True,
    ),
)
