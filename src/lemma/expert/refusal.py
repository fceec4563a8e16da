"""Why a sub-task cannot be done: one answer, at whatever level it was asked for."""

from lemma.expert.grounding import GeometricGrounder, GroundedOption
from lemma.expert.symbolic_state import SymbolicState
from lemma.motion.outcome import Outcome, SkillResult
from lemma.scene.spec import SHARED, STICK
from lemma.tasks.subtask import Primitive, SubTask

_TOOL = {
    Primitive.HOOK: Primitive.PREHOOK,
    Primitive.POKE: Primitive.PREPOKE,
}
"""What must come before a primitive."""


def ground_or_refuse(
    subtask: SubTask, now: SymbolicState, grounder: GeometricGrounder
) -> GroundedOption | SkillResult:
    """Return a sub-task with poses, or how it ends where there are none.

    Args:
        subtask: In symbols; not ``stop``.
        now: The true state.
        grounder: Of the same scene.

    Returns:
        The grounded sub-task; or a result that took no time: ``invalid`` where nobody
        could do it, ``unreachable`` where this robot cannot.

    Raises:
        UnknownNameError: There is no such robot in this scene.
    """
    senseless = _why_senseless(subtask, now)
    if senseless is not None:
        return SkillResult(Outcome.INVALID, senseless, 0.0)
    option = grounder.ground(subtask, now)
    if option is not None:
        return option
    reason = _why_unreachable(subtask, now, grounder)
    return SkillResult(Outcome.UNREACHABLE, reason, 0.0)


def _why_senseless(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why nobody could do a sub-task, None if somebody might."""
    pick, place, primitive = subtask.pick, subtask.place, subtask.primitive
    for name in (pick, place):
        if name == "":
            return f"{primitive} needs something to pick and a place."
        if name != SHARED and name not in now.poses:
            return f"There is no {name} on this table, only {', '.join(now.poses)}."
    if primitive is not Primitive.MOVE:
        if pick != STICK:
            return f"{primitive} is done with the stick, not with the {pick}."
        if place not in now.supports:
            return f"{primitive} acts on a cube, not on {place}."
        before = _TOOL.get(primitive)
        if before is not None and not now.is_prepared(primitive, place):
            return f"The stick does not lie ready for {place}: {before} comes first."
        return None
    if pick == STICK:
        return None if place == SHARED else f"The stick cannot be put on {place}."
    if pick not in now.supports:
        return f"The {pick} is fixed to the table."
    if place in (pick, STICK):
        return f"The {pick} cannot be put on {place}."
    for name in (pick, place):
        above = None if name == SHARED else now.on_top_of(name)
        if above is not None and above != pick:
            return f"The {above} lies on the {name}."
    return f"The {pick} lies there already." if now.supports[pick] == place else None


def _why_unreachable(
    subtask: SubTask, now: SymbolicState, grounder: GeometricGrounder
) -> str:
    """Return why a robot cannot do a sub-task that makes sense."""
    robot = subtask.robot
    arm = grounder.robots[robot].arm
    for name in (subtask.pick, subtask.place):
        if subtask.primitive is not Primitive.MOVE or name in (SHARED, STICK):
            continue
        if not grounder.reaches(robot, now.poses[name]):
            return f"{robot} ({arm}) cannot reach the {name}."
    return (
        f"{robot} ({arm}) finds no way to {subtask.primitive} the {subtask.pick} "
        f"for {subtask.place}: it is too far, or something is in the way."
    )
