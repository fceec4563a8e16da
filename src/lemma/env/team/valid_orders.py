"""Valid orders of a free robot, from which plan-level masks are made."""

from collections.abc import Iterator

from lemma.planning.grounding import (
    GeometricGrounder,
    GroundedOption,
    ground_or_refuse,
)
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.subtask import Primitive, SubTask, primitive_names


def valid_options(
    robot: str, state: SymbolicState, grounder: GeometricGrounder
) -> Iterator[GroundedOption]:
    """Yield the sub-tasks that a robot could do in a state, with poses and effects.

    Args:
        robot: Its name.
        state: The present state, or the state expected after all orders in progress
            (:meth:`lemma.env.team.orders.Team.expected`).
        grounder: Grounder of the same scene.
    """
    ends = (*state.poses, *state.spec.regions)
    for primitive in map(Primitive, primitive_names()):
        if primitive is Primitive.STOP:
            continue
        for pick in state.poses:
            for place in ends:
                subtask = SubTask(robot, primitive, pick, place)
                found = ground_or_refuse(subtask, state, grounder)
                if isinstance(found, GroundedOption):
                    yield found
