"""Sub-tasks as ReachNet's numbers, and back."""

from collections.abc import Sequence

from lemma.core.robot_names import robot_name
from lemma.policies.batch import NOBODY, PRIMITIVES, STOP, decision_numbers
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.interfaces import PolicyInput
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import Primitive, SubTask

_SUCCESS = "success"


def subtask_of(row: Sequence[int], entities: EntitySet = BENCHMARK) -> SubTask:
    """Return a sub-task of numbers: robot, primitive, pick, place."""
    places = entities.places
    robot, primitive, pick, place = row
    if primitive == STOP:
        return STOP_SUBTASK
    return SubTask(
        robot_name(robot), Primitive(PRIMITIVES[primitive]), places[pick], places[place]
    )


def numbers_of(
    subtask: SubTask, robots: int, entities: EntitySet = BENCHMARK
) -> list[int]:
    """Return a sub-task as numbers; those of ``stop`` if it makes no sense."""
    nothing = [NOBODY, STOP, NOBODY, NOBODY]
    try:
        numbers = decision_numbers(subtask.to_dict(), entities)
    except ValueError:
        return nothing
    robot, _, pick, place = numbers
    cargo, stick = range(entities.cargo), entities.stick
    if subtask.primitive is Primitive.MOVE:
        onto = place in range(stick) and place != pick
        fits = (pick in cargo and (onto or place > stick)) or (
            pick == stick and place > stick
        )
    else:
        fits = pick == stick and place in cargo
    return numbers if fits and 0 <= robot < robots else nothing


def failures_in(given: PolicyInput) -> list[SubTask]:
    """Return what has failed since something last succeeded."""
    failed = []
    for step in reversed(given.past):
        if step.outcome == _SUCCESS:
            break
        failed.append(step.subtask)
    return failed
