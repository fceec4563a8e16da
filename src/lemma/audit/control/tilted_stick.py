"""Hook with a leaning hand that holds the stick, then pick and place."""

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control.stick_in_hand import (
    hook_home,
    leans_for_stick,
    require_stick,
)
from lemma.audit.control.tilted_move import put_on
from lemma.audit.control_trial import ControlTrial
from lemma.audit.handling import is_home
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M

_TRIES = 3


def tilted_stick(trial: ControlTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    longest_m = HANDLE_LENGTH_M + HOOK_LENGTH_M
    for on in trial.goal.conjuncts:
        support_m = kind_of(on.bottom).support_m or 0.0
        for name in (on.top, on.bottom):
            limit_m = trial.could.place_m + support_m
            if kind_of(name).cargo:
                limit_m += longest_m
            if trial.radius(trial.pose(name)) > limit_m:
                raise GiveUp
    leans = leans_for_stick(trial)
    if trial.attempt >= min(_TRIES, len(leans)):
        raise GiveUp
    lean = leans[-1 - trial.attempt * (len(leans) // _TRIES)]
    for name in trial.goal.entities:
        if kind_of(name).cargo and not is_home(trial, name):
            hook_home(trial, name, lean)
    for on in trial.goal.conjuncts:
        put_on(trial, on)


ATTACKS.add(
    "tilted_stick",
    Attack(
        name="tilted_stick",
        summary="Hooks with a leaning hand that holds the stick, then builds alone.",
        level="control",
        play=tilted_stick,
        attempts=_TRIES,
    ),
)
