"""Sub-tasks as ReachNet's numbers, and back."""

from collections.abc import Sequence

from lemma.core.robot_names import robot_name
from lemma.policies.batch import NOBODY, PLACES, PRIMITIVES, STOP, decision_numbers
from lemma.policies.interfaces import PolicyInput
from lemma.policies.models.reachnet.scene_table import CUBES, THE_STICK
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import Primitive, SubTask

_SUCCESS = "success"


def subtask_of(row: Sequence[int]) -> SubTask:
    """Return a sub-task of numbers: robot, primitive, pick, place."""
    robot, primitive, pick, place = row
    if primitive == STOP:
        return STOP_SUBTASK
    return SubTask(
        robot_name(robot), Primitive(PRIMITIVES[primitive]), PLACES[pick], PLACES[place]
    )


def numbers_of(subtask: SubTask, robots: int) -> list[int]:
    """Return a sub-task as numbers; those of ``stop`` if it makes no sense."""
    nothing = [NOBODY, STOP, NOBODY, NOBODY]
    try:
        numbers = decision_numbers(subtask.to_dict())
    except ValueError:
        return nothing
    robot, _, pick, place = numbers
    cube = range(len(CUBES))
    if subtask.primitive is Primitive.MOVE:
        onto = place in range(THE_STICK) and place != pick
        fits = (pick in cube and (onto or place > THE_STICK)) or (
            pick == THE_STICK and place > THE_STICK
        )
    else:
        fits = pick == THE_STICK and place in cube
    return numbers if fits and 0 <= robot < robots else nothing


def failures_in(given: PolicyInput) -> list[SubTask]:
    """Return what has failed since something last succeeded."""
    failed = []
    for step in reversed(given.past):
        if step.outcome == _SUCCESS:
            break
        failed.append(step.subtask)
    return failed
