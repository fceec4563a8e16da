"""Pick and place with a hand that leans outwards: it reaches farther."""

import math
from collections.abc import Iterator
from itertools import islice

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import LEANS_RAD
from lemma.audit.handling import (
    Hold,
    approach,
    holds,
    let_go,
    pick_up,
    places,
    resting_height,
)
from lemma.core.poses import FloatArray
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_ABOVE_M = 0.004
_DROP_M = (0.03, 0.08)
_QUARTER = math.pi / 2
_AHEAD_M = (0.0, 0.022)
"""How far ahead of the tool centre point a cube is held: at last by the fingertips."""
_ATTEMPTS = 6
_DOUBT_M = 0.03
"""Inverse kinematics is asked somewhat beyond what is known to be out of reach."""


def tilted_move(trial: ControlTrial) -> None:
    """Play an attempt."""
    for on in trial.goal.conjuncts:
        support_m = kind_of(on.bottom).support_m or 0.0
        farthest_m = trial.could.place_m + support_m + _DOUBT_M
        if trial.radius(trial.pose(on.bottom)) > farthest_m:
            raise GiveUp
    for on in trial.goal.conjuncts:
        if not put_on(trial, on, trial.attempt):
            return


def put_on(trial: ControlTrial, on: On, number: int = 0) -> bool:
    """Put a top on its bottom, wherever the two are; return whether that went.

    Args:
        trial: The attempt.
        on: What shall hold.
        number: Which of the ways that geometry allows.

    Raises:
        GiveUp: There are not so many.
    """
    way = next(islice(ways(trial, on), number, None), None)
    if way is None:
        raise GiveUp
    hold, place = way
    if not pick_up(trial, hold.hand):
        return False
    if not approach(trial, place, 0.0, 0.06, lift_m=0.06):
        return False
    let_go(trial, place)
    return True


def ways(trial: ControlTrial, on: On) -> Iterator[tuple[Hold, FloatArray]]:
    """Yield how a cube can be held, and where the hand then sets it down or drops it.

    What is held leans with the hand. It stands upright again if the hand leans the same
    at the end, or by a quarter turn more; if it is dropped, it may.
    """
    rest_m = resting_height(trial, on.top, on.bottom)
    flush = [(0.0, _ABOVE_M), (_QUARTER, _ABOVE_M)]
    drops = [(more, high) for high in _DROP_M for more in (0.6, 0.9, 1.2)]
    for more, high in (*flush, *drops):
        for ahead_m in _AHEAD_M:
            found = _first(trial, on, more, ahead_m, rest_m + high)
            if found is not None:
                yield found


def _first(
    trial: ControlTrial, on: On, more: float, ahead_m: float, z: float
) -> tuple[Hold, FloatArray] | None:
    """Return the way with the least lean, if there is one."""
    for lean in LEANS_RAD:
        place = next(places(trial, on.bottom, z, lean + more, ahead_m), None)
        if place is None:
            continue
        hold = next(holds(trial, on.top, lean, ahead_m), None)
        if hold is not None:
            return hold, place
    return None


ATTACKS.add(
    "tilted_move",
    Attack(
        name="tilted_move",
        summary="Picks and places with a hand that leans outwards, or drops.",
        level="control",
        play=tilted_move,
        attempts=_ATTEMPTS,
        cheap=True,
    ),
)
