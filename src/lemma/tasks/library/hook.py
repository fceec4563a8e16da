"""Hook: a cube that nobody reaches is dragged closer with the stick."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import Board
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task


def arrange(board: Board) -> Goal:
    """Set the table."""
    first, second = board.order[:2]
    cube = board.cube(board.tool_only(Primitive.HOOK, first, second))
    # Out of the first robot's way even with the stick: it cannot carry a cube there.
    pad = board.pad(board.only(second, tool=True))
    board.stick(first)
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
