"""The cause of an episode's failure, derived from its line.

The expert was asked before every sub-task
(:mod:`lemma.evaluation.run.expert_feedback`), and once more at the end, how many
sub-tasks it would need from there. A sub-task is a *mistake* if, in the rest of the
episode, that number never falls below its value before the sub-task. So a sub-task that
serves the goal is no mistake, even if the expert would have chosen another, and neither
is one whose harm was repaired later. The first mistake decides the cause. A refused
sub-task leaves the number unchanged, so a protective stop is a mistake; its cause
classifies the refused sub-task.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from lemma.evaluation.records import (
    POLICY_ERROR,
    POSE_TOLERANCE_MM,
    Deviation,
    enough,
)
from lemma.motion.outcome import Outcome


class Cause(StrEnum):
    """Causes of failure."""

    WRONG_ROBOT = "wrong_robot"
    """The mistake differs only in its robot from a sub-task of the expert's plan, the
    next or a later one."""
    WRONG_ORDER = "wrong_order"
    """The mistake is a later sub-task of the expert's plan: it came too soon."""
    WRONG_PRIMITIVE = "wrong_primitive"
    """The mistake has another primitive than the expert's next sub-task, which is
    ``stop`` where the goal held already."""
    WRONG_OBJECT = "wrong_object"
    """The mistake has the expert's primitive, but picks something else or puts it
    elsewhere."""
    MISSED_PICK = "missed_pick"
    """The mistake is the expert's sub-task. No pose was found, or the pick is more than
    20 mm off the middle of the cube, or, where the stick is picked, there was nothing
    between the fingers."""
    MISSED_PLACE = "missed_place"
    """The mistake is the expert's sub-task. The place is more than 20 mm off the middle
    of the pad or cube, or, in the shared region and with tools, where no single pose is
    right, it is out of reach, or the motion was carried out and did not help."""
    FELL = "fell"
    """The mistake is the expert's sub-task, and in it something fell off the table; at
    control level, anything fell."""
    EXECUTION = "execution"
    """The mistake is the expert's sub-task with good poses, and the motion failed:
    dropped, collided, did not end. Also where nothing was left to do, and the goal does
    not hold at rest."""
    OUT_OF_TIME = "out_of_time"
    """There is no mistake, or time ran out during the first one."""
    STOPPED_EARLY = "stopped_early"
    """There is no mistake, and ``stop`` came before the goal held."""
    THROWN = "thrown"
    """An object flew, or kept moving without a robot."""
    RULE = "rule"
    """The rule of the goal was broken."""
    UNTOUCHED = "untouched"
    """Control level: no hand and no tool touched a cube that the goal moves;
    on *reach*, none was held over it."""
    UNGRASPED = "ungrasped"
    """Control level: such a cube was touched, and none was ever between two fingers."""
    MISPLACED = "misplaced"
    """Control level: such a cube was grasped, and the goal does not hold at the end."""
    POLICY_ERROR = "policy_error"
    """The policy raised an exception, timed out, or returned an invalid decision; the
    line has the details."""


OF_CONTROL = frozenset({Cause.UNTOUCHED, Cause.UNGRASPED, Cause.MISPLACED})
"""Causes of episodes at control level alone."""
OF_NAMES = frozenset(
    {
        *(Cause.WRONG_ROBOT, Cause.WRONG_ORDER, Cause.MISSED_PICK),
        *(Cause.MISSED_PLACE, Cause.EXECUTION, Cause.FELL),
    }
)
"""Causes told of sub-tasks that name objects. End-to-end models name none, so that none
of their sub-tasks equals one of a plan, and the mistake is a wrong primitive or object;
only a goal that does not hold at rest is an execution of theirs, too."""
OF_SUBTASKS = (OF_NAMES - {Cause.FELL}) | {
    *(Cause.WRONG_PRIMITIVE, Cause.WRONG_OBJECT),
    *(Cause.OUT_OF_TIME, Cause.STOPPED_EARLY),
}
"""Causes told of sub-tasks, which episodes at control level do not have."""

_OF_DEVIATION = {
    Deviation.ROBOT: Cause.WRONG_ROBOT,
    Deviation.ORDER: Cause.WRONG_ORDER,
    Deviation.PRIMITIVE: Cause.WRONG_PRIMITIVE,
    Deviation.OBJECT: Cause.WRONG_OBJECT,
}


def cause_of(row: Mapping[str, Any]) -> Cause | None:
    """Return why an episode failed; None if it succeeded.

    Args:
        row: A line of ``episodes.jsonl``.
    """
    if row["success"]:
        return None
    if row["failure"] == POLICY_ERROR:
        return Cause.POLICY_ERROR
    if row["failure"] in (Outcome.THROWN, Outcome.RULE):
        return Cause(row["failure"])
    if row.get("control"):
        return _of_control(row["control"])
    mistake = mistake_of(row)
    if mistake is not None:
        return _of_mistake(row["subtasks"][mistake])
    if row["failure"] == Outcome.OUT_OF_TIME:
        return Cause.OUT_OF_TIME
    return Cause.STOPPED_EARLY if enough(row["left"]) else Cause.EXECUTION


def _of_control(control: Mapping[str, Any]) -> Cause:
    """Return the cause at control level, from contacts and grasps."""
    if control["fallen"]:
        return Cause.FELL
    if not control["touched"]:
        return Cause.UNTOUCHED
    grasped = {each["object"] for each in control["events"]}
    return Cause.MISPLACED if grasped & {*control["touched"]} else Cause.UNGRASPED


def mistake_of(row: Mapping[str, Any]) -> int | None:
    """Return the index of the first mistake among the sub-tasks; None without one.

    Args:
        row: A line of ``episodes.jsonl``.
    """
    steps = row["subtasks"]
    left = [enough(step["expert"]["left"]) for step in steps] + [enough(row["left"])]
    found = (i for i in range(len(steps)) if min(left[i + 1 :]) >= left[i])
    return next(found, None)


def _of_mistake(step: Mapping[str, Any]) -> Cause:
    deviation = Deviation(step["expert"]["departure"])
    if deviation is not Deviation.NONE:
        return _OF_DEVIATION[deviation]
    outcome = Outcome(step["outcome"])
    if outcome is Outcome.OUT_OF_TIME:
        return Cause.OUT_OF_TIME
    if step["fell"]:
        return Cause.FELL
    for end, cause, telling in _MISSED:
        error_mm = step["expert"][f"{end}_error_mm"]
        if outcome in telling if error_mm is None else error_mm > POSE_TOLERANCE_MM:
            return cause
    return Cause.EXECUTION


_MISSED = (
    (
        "pick",
        Cause.MISSED_PICK,
        (
            Outcome.INVALID,
            Outcome.NOTHING_TO_PICK,
            Outcome.OVERLOAD,
            Outcome.MISSED_GRASP,
        ),
    ),
    ("place", Cause.MISSED_PLACE, (Outcome.SUCCESS, Outcome.UNREACHABLE)),
)
"""Ends of a sub-task, with the outcomes that mean a miss if no single pose is right."""
