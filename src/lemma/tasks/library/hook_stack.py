"""Hook and stack: both robots hook a cube, with one stick between them."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task


def arrange(placer: ObjectPlacer) -> Goal:
    """Set the table."""
    first, second = placer.order[:2]
    top = placer.cube(placer.tool_only(Primitive.HOOK, first, second, alone=True))
    bottom = placer.cube(placer.tool_only(Primitive.HOOK, second, first, alone=True))
    placer.stick(first)
    return Goal((On(top, bottom),))


TASKS.add(
    "hook_stack",
    Task(
        name="hook_stack",
        summary="Each robot hooks a cube with the one stick; then they stack them.",
        subtasks=7,
        distractors=(0, 3),
        arrange=arrange,
        language=bank_for("hook_stack"),
    ),
)
