"""Hook and stack: both robots hook a cube, with one stick between them."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import Board
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task


def arrange(board: Board) -> Goal:
    """Set the table."""
    first, second = board.order[:2]
    top = board.cube(board.tool_only(Primitive.HOOK, first, second, alone=True))
    bottom = board.cube(board.tool_only(Primitive.HOOK, second, first, alone=True))
    board.stick(first)
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
