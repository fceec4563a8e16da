"""From a symbolic sub-task to gripper poses: the oracle's geometry.

Each grounding also says what will be true afterwards and how good it is, which is what
the planner's utility is made of. :mod:`lemma.planning.primitives` says how each
primitive is grounded. A sub-task that cannot be done is refused with the same outcome
at every level.
"""

from lemma.core.errors import UnknownNameError
from lemma.motion.outcome import Outcome, SkillResult, has_fallen
from lemma.planning.geometry import GroundedOption, SceneGeometry
from lemma.planning.primitives import PRIMITIVES
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import STICK
from lemma.tasks.subtask import Primitive, SubTask

__all__ = ["GeometricGrounder", "GroundedOption", "ground_or_refuse"]


class GeometricGrounder(SceneGeometry):
    """Chooses grasp, place and tool poses from the true state."""

    def ground(self, subtask: SubTask, now: SymbolicState) -> GroundedOption | None:
        """Ground a sub-task, or return None where its robot cannot do it.

        Raises:
            UnknownNameError: No such robot.
        """
        if subtask.primitive is Primitive.STOP:
            return None
        if subtask.robot not in self.robots:
            raise UnknownNameError("robot", subtask.robot, self.robots)
        if subtask.pick not in now.poses or subtask.place in now.fallen:
            return None
        spec = PRIMITIVES[subtask.primitive]
        if spec.tool and (subtask.pick != STICK or subtask.place not in now.supports):
            return None
        return spec.ground(self, subtask, now)


def ground_or_refuse(
    subtask: SubTask, now: SymbolicState, grounder: GeometricGrounder
) -> GroundedOption | SkillResult:
    """Return a sub-task with poses, or how it ends where there are none.

    Args:
        subtask: In symbols; not ``stop``.
        now: The true state.
        grounder: Of the same scene.

    Returns:
        The grounded sub-task; or a result that took no time: ``fallen`` where what it
        needs is lost, ``invalid`` where nobody could do it, ``overload`` where it
        reaches what it cannot carry, ``unreachable`` where else this robot cannot.

    Raises:
        UnknownNameError: There is no such robot in this scene.
    """
    for name in (subtask.pick, subtask.place):
        if name in now.fallen:
            return SkillResult(Outcome.FALLEN, has_fallen(name), 0.0)
    senseless = _why_senseless(subtask, now)
    if senseless is not None:
        return SkillResult(Outcome.INVALID, senseless, 0.0)
    option = grounder.ground(subtask, now)
    if option is not None:
        return option
    if subtask.primitive in (Primitive.MOVE, Primitive.LIFT):
        too_heavy = grounder.overload(subtask.robot, subtask.pick)
        if too_heavy and grounder.reaches(subtask.robot, now.poses[subtask.pick]):
            return SkillResult(Outcome.OVERLOAD, too_heavy, 0.0)
    reason = _why_unreachable(subtask, now, grounder)
    return SkillResult(Outcome.UNREACHABLE, reason, 0.0)


def _why_senseless(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why nobody could do a sub-task, None if somebody might."""
    pick, place, primitive = subtask.pick, subtask.place, subtask.primitive
    for name in (pick, place):
        if name == "":
            return f"{primitive} needs something to pick and a place."
        if name not in now.spec.regions and name not in now.poses:
            return f"There is no {name} on this table, only {', '.join(now.poses)}."
    spec = PRIMITIVES[primitive]
    if spec.tool and pick != STICK:
        return f"{primitive} is done with the stick, not with the {pick}."
    if spec.tool and place not in now.supports:
        return f"{primitive} acts on a cube, not on {place}."
    return spec.why_not(subtask, now)


def _why_unreachable(
    subtask: SubTask, now: SymbolicState, grounder: GeometricGrounder
) -> str:
    """Return why a robot cannot do a sub-task that makes sense."""
    robot = subtask.robot
    arm = grounder.robots[robot].arm
    for name in (subtask.pick, subtask.place):
        if PRIMITIVES[subtask.primitive].tool or name in (*grounder.regions, STICK):
            continue
        if not grounder.reaches(robot, now.poses[name]):
            return f"{robot} ({arm}) cannot reach the {name}."
    return (
        f"{robot} ({arm}) finds no way to {subtask.primitive} the {subtask.pick} "
        f"for {subtask.place}: it is too far, or something is in the way."
    )
