"""Attacks on what two robots carry: one robot takes one handle of it."""

import math

from lemma.audit.attack import attack
from lemma.audit.control_trial import ControlTrial, leaning, moved
from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_RAISED_M = (0.0, 0.08, 0.25)
"""How far the handle is raised on the way, by attempt; at first it is dragged."""


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
