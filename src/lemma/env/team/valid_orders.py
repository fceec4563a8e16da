"""Orders that a free robot could be given: what plan-level masks are made of."""

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
        state: Where things are, or what all that is under way will leave behind
            (:meth:`lemma.env.team.orders.Team.expected`).
        grounder: Of the same scene.
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
