"""Pass: a cube must change sides."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import Board
from lemma.tasks.task import TASKS, Task


def arrange(board: Board) -> Goal:
    """Set the table."""
    first, second = board.order[:2]
    cube = board.cube(board.only(first))
    pad = board.pad(board.only(second))
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
