"""The expert's judgement of a policy's decisions.

The expert plans from the true state before every sub-task of a policy, which takes some
milliseconds and does not change the state. The length of its plan measures whether a
sub-task served the goal, also if several sub-tasks are good.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from lemma.env.episode import Episode
from lemma.evaluation.line_parts import Symbols
from lemma.evaluation.records import Deviation, Feedback, Row, enough
from lemma.motion.outcome import Outcome, SkillResult
from lemma.planning.grounding import GeometricGrounder, ground_or_refuse
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import Decision
from lemma.scene.objects.entity import STICK, is_carried
from lemma.tasks.subtask import JOINT, STOP, Primitive, SubTask


def left_in(episode: Episode, now: SymbolicState | None = None) -> int | None:
    """Return the length of the expert's plan; None without a plan.

    Args:
        episode: The episode.
        now: State from which to plan; the present one if None.
    """
    now = now or SymbolicState.observe(episode.simulation.scene)
    plan = _plan(episode, now, GeometricGrounder(now.spec))
    return None if plan is None else len(plan)


def advise(
    episode: Episode, decision: Decision, now: SymbolicState | None = None
) -> Feedback:
    """Return the expert's judgement of a decision in an episode.

    Args:
        episode: The episode.
        decision: A decision other than ``stop``.
        now: State of the decision, such as the expected one after all active orders;
            the present one if None.
    """
    now = now or SymbolicState.observe(episode.simulation.scene)
    geometry = GeometricGrounder(now.spec)
    plan = _plan(episode, now, geometry)
    subtask = decision.subtask
    deviates = deviation(subtask, plan or ())
    pick = place = None
    if decision.grounded is not None:
        held = bool(subtask.pick) and is_carried(subtask.pick)
        joint = held or subtask.primitive in JOINT
        if subtask.pick in now.poses and subtask.pick != STICK and not joint:
            pick = decision.grounded.pick.distance(now.poses[subtask.pick])
        if subtask.primitive is Primitive.MOVE and subtask.place in now.poses:
            place = decision.grounded.place.distance(now.poses[subtask.place])
    return Feedback(
        expected=Symbols(**(plan[0] if plan else STOP).to_dict()),
        left=None if plan is None else len(plan),
        departure=deviates,
        able=deviates is Deviation.NONE or _is_able(subtask, now, geometry),
        pick_error_mm=_millimetres(pick),
        place_error_mm=_millimetres(place),
    )


def refuse(episode: Episode, decision: Decision) -> SkillResult:
    """Return the result of a decision without poses, as at plan level if infeasible."""
    scene = episode.simulation.scene
    found = ground_or_refuse(
        decision.subtask, SymbolicState.observe(scene), GeometricGrounder(scene.spec)
    )
    if isinstance(found, SkillResult):
        return found
    why = decision.explanation or f"No pose was found for: {decision.subtask}."
    return SkillResult(Outcome.INVALID, why, 0.0)


def count_steps(steps: Sequence[Row], left: int | None) -> dict[str, int]:
    """Count the expert's judgements of the sub-tasks of an episode.

    Args:
        steps: Sub-tasks of its line.
        left: Length of the expert's plan after the last one; None without a plan.

    Returns:
        ``doable``, ``able``, ``planned``, ``as_expert`` and ``order_violations``.
    """
    feedback = [step["expert"] for step in steps]
    lefts = [enough(each["left"]) for each in feedback] + [enough(left)]
    deviations = [Deviation(each["departure"]) for each in feedback]
    as_expert = sum(d in (Deviation.NONE, Deviation.ORDER) for d in deviations)
    return {
        "doable": sum(each["able"] is not None for each in feedback),
        "able": sum(each["able"] is True for each in feedback),
        "planned": as_expert + deviations.count(Deviation.ROBOT),
        "as_expert": as_expert,
        "order_violations": sum(
            deviations[i] is Deviation.ORDER
            and lefts[i + 1] >= lefts[i]
            and (not feedback[i]["able"] or step["outcome"] == Outcome.SUCCESS)
            for i, step in enumerate(steps)
        ),
    }


def deviation(subtask: SubTask, plan: tuple[SubTask, ...]) -> Deviation:
    """Return the first kind of deviation of a sub-task from a plan that applies.

    Args:
        subtask: Decision of a policy, other than ``stop``.
        plan: The expert's remaining sub-tasks; empty if the goal holds.
    """
    expected = plan[0] if plan else STOP
    if subtask == expected:
        return Deviation.NONE
    if subtask in plan:
        return Deviation.ORDER
    if any(replace(planned, robot=subtask.robot) == subtask for planned in plan):
        return Deviation.ROBOT
    if subtask.primitive is not expected.primitive:
        return Deviation.PRIMITIVE
    return Deviation.OBJECT


def _is_able(
    subtask: SubTask, now: SymbolicState, geometry: GeometricGrounder
) -> bool | None:
    if geometry.ground(subtask, now) is not None:
        return True
    others = (replace(subtask, robot=robot) for robot in geometry.robots)
    can_others = any(geometry.ground(other, now) is not None for other in others)
    return False if can_others else None


def _plan(
    episode: Episode, now: SymbolicState, geometry: GeometricGrounder
) -> tuple[SubTask, ...] | None:
    plan = find_plan(now, episode.instance.goal, geometry)
    return None if plan is None else plan.subtasks


def _millimetres(metres: float | None) -> float | None:
    if metres is None or not math.isfinite(metres):
        return None
    return round(1000.0 * metres, 1)
