"""Poke and stack: two cubes are pushed over, then stacked."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    top = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    bottom = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    placer.stick(first)
    return Goal((On(top, bottom),))


TASKS.add(
    "poke_stack",
    Task(
        name="poke_stack",
        summary="One robot pokes two cubes over, the other stacks them.",
        subtasks=5,
        distractors=(0, 2),
        arrange=arrange,
        language=bank_for("poke_stack"),
        apart=True,
    ),
)
