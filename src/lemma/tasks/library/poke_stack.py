"""Poke and stack: two cubes are pushed over, then stacked."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import Board
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task


def arrange(board: Board) -> Goal:
    """Set the table."""
    first, second = board.order[:2]
    top = board.cube(board.tool_only(Primitive.POKE, first, second))
    bottom = board.cube(board.tool_only(Primitive.POKE, first, second))
    board.stick(first)
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
