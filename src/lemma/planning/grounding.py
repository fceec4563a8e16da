"""Grounding of symbolic sub-tasks: gripper poses from the true state.

A grounding also has the predicted state after the sub-task, and the quality and
duration from which the planner computes utility. The ground function of each primitive
is in :mod:`lemma.planning.primitives`. An infeasible sub-task is refused with the same
outcome at every level.
"""

from dataclasses import replace

from lemma.core.arguments import known
from lemma.core.poses import Pose2
from lemma.motion.outcome import Outcome, SkillResult, has_fallen
from lemma.planning.geometry import GroundedOption, SceneGeometry
from lemma.planning.primitives import PRIMITIVES
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.scene.objects.entity import STICK
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

__all__ = [
    "GeometricGrounder",
    "GroundedOption",
    "at_poses",
    "ground_or_refuse",
    "is_as_predicted",
]

_AS_PREDICTED_M = 0.03


class GeometricGrounder(SceneGeometry):
    """Chooses grasp, place and tool poses from the true state."""

    def ground(self, subtask: SubTask, now: SymbolicState) -> GroundedOption | None:
        """Ground a sub-task.

        Args:
            subtask: The sub-task.
            now: The present state.

        Returns:
            The grounding, or None if the robot cannot do the sub-task.

        Raises:
            UnknownNameError: No such robot.
        """
        if subtask.primitive is Primitive.STOP:
            return None
        known("robot", subtask.robot, self.robots)
        if subtask.pick not in now.poses or subtask.place in now.fallen:
            return None
        spec = PRIMITIVES[subtask.primitive]
        if spec.tool and (subtask.pick != STICK or subtask.place not in now.supports):
            return None
        return spec.ground(self, subtask, now)


def ground_or_refuse(
    subtask: SubTask, now: SymbolicState, grounder: GeometricGrounder
) -> GroundedOption | SkillResult:
    """Ground a sub-task, or refuse it with a result.

    Args:
        subtask: The symbolic sub-task; not ``stop``.
        now: The true state.
        grounder: Grounder of the same scene.

    Returns:
        The grounding; or a result of zero duration: ``fallen`` if an object that it
        needs has fallen off the table, ``invalid`` if no robot could do it,
        ``overload`` if this robot reaches the object but cannot carry it,
        ``unreachable`` if it cannot do it for another reason.

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
    """Return why no robot could do a sub-task; None if it is valid."""
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
    """Return why a robot cannot do a valid sub-task."""
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


def is_as_predicted(
    now: SymbolicState, option: GroundedOption, before: SymbolicState
) -> bool:
    """Return whether the objects that an option moves lie as it predicted.

    Args:
        now: The present state.
        option: The grounded option.
        before: The state in which it was grounded.
    """
    after = option.after
    return all(
        now.supports.get(name) == after.supports.get(name)
        and now.seconds.get(name) == after.seconds.get(name)
        and now.poses[name].distance(pose) < _AS_PREDICTED_M
        for name, pose in after.poses.items()
        if pose != before.poses[name] and name in now.poses
    )


def at_poses(option: GroundedOption, grounded: GroundedSubTask) -> GroundedOption:
    """Return an option whose effect is at a policy's own poses."""
    pick = option.subtask.pick
    pose = option.after.poses.get(pick)
    if option.subtask.primitive is not Primitive.MOVE or pose is None:
        return replace(option, grounded=grounded)
    at = Pose2(grounded.place.x, grounded.place.y, pose.yaw)
    after, support = option.after, option.after.supports.get(pick, TABLE)
    second = after.seconds.get(pick)
    moved = after.moved(pick, at, support, after.labels[pick], second)
    return replace(option, grounded=grounded, after=moved)
