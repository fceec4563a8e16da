"""Attacks on what takes two hands: one robot takes one handle, or one end."""

import math

from lemma.audit.attack import attack
from lemma.audit.control_trial import LEANS_RAD, ControlTrial, leaning, moved
from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_FROM_END_M = (0.035, 0.01)
"""How far from its end a hand holds a thing, by attempt."""
_RAISED_M = (0.0, 0.08, 0.25)
"""How far the handle is raised on the way, by attempt; at first it is dragged."""
_CLEAR_M = 0.06
"""From so far above a thing is laid down."""


@attack("control", attempts=len(_RAISED_M))
def one_handle(trial: ControlTrial) -> None:
    """Takes a tray by one handle, and puts that end onto the rack."""
    carried = [on for on in trial.goal.placements if kind_of(on.top).carried]
    trial.require(carried)
    for on in carried:
        hold, put = _hands(trial, on)
        trial.require(trial.can(hold, put))
        up_m = _RAISED_M[trial.attempt]
        if not trial.pick_up(hold):
            return
        way = [moved(hold, dz=up_m), moved(put, dz=up_m), put]
        if not trial.lead(way, 0.0):
            return
        trial.let_go(put)


def _hands(trial: ControlTrial, on: On) -> tuple[FloatArray, FloatArray]:
    """Return the hand at the nearer handle, where it is and where it shall be."""
    carried, start = kind_of(on.top).carried, trial.pose(on.top)
    assert carried is not None
    base, target = trial.placement.base, trial.pose(on.bottom)
    grasp = min(carried.handles, key=lambda g: base.distance(start @ g.at))
    ends = [target, target @ Pose2(0.0, 0.0, math.pi)]
    end = min(ends, key=lambda pose: base.distance(pose @ grasp.at))
    rise_m = kind_of(on.bottom).height_m
    low = leaning(start @ grasp.at, grasp.height_m)
    return low, leaning(end @ grasp.at, rise_m + grasp.height_m)


@attack("control", attempts=len(_FROM_END_M))
def far_end(trial: ControlTrial) -> None:
    """Holds a bar by one end, and lays it down as far away as that gets it."""
    given = [on for on in trial.goal.placements if kind_of(on.top).ends]
    trial.require(given)
    for on in given:
        half_m = kind_of(on.top).disc_m
        trial.require_near(on.bottom, trial.could.touch_m + half_m)
        out_m = half_m - _FROM_END_M[trial.attempt]
        hands = (_at_an_end(trial, on, out_m, lean) for lean in LEANS_RAD)
        hold, put = next((h for h in hands if trial.can(*h)), (None, None))
        trial.require(hold is not None)
        if hold is None or put is None or not trial.pick_up(hold):
            return
        if not trial.lead([moved(put, dz=_CLEAR_M), put], 0.0, 0.3):
            return
        trial.let_go(put)


def _at_an_end(
    trial: ControlTrial, on: On, out_m: float, lean: float
) -> tuple[FloatArray, FloatArray]:
    """Return the hand at the nearer end of a bar, and where it lays the bar down.

    Args:
        trial: The attempt.
        on: The condition to reach: a bar on its bottom.
        out_m: From the middle of the bar to the hand [m].
        lean: Of the hand, from the vertical [rad]; the bar is level at both.
    """
    start, target = trial.pose(on.top), trial.pose(on.bottom)
    ends = kind_of(on.top).ends
    assert ends is not None
    height_m, base = ends[0].height_m, trial.placement.base
    ways = [start, start @ Pose2(0.0, 0.0, math.pi)]
    hold = min((at @ Pose2(-out_m, 0.0) for at in ways), key=base.distance)
    along = Pose2(target.x, target.y, trial.outward(target))
    put_m = kind_of(on.bottom).height_m + height_m
    put = leaning(along @ Pose2(-out_m, 0.0), put_m, lean)
    return leaning(hold, height_m, lean), put
