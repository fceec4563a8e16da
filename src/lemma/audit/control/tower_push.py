"""A tower as a step: push it against a pad with the stick, then push its top over."""

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control.climbing import climb
from lemma.audit.control.stick_in_hand import hook_home, require_stick
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import leaning
from lemma.audit.handling import approach, base_to, holds, let_go, pick_up
from lemma.core.poses import Pose2
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M

_HANDS_M = (0.45, 0.30, 0.15)
"""Where along the handle the stick is held, by attempt."""
_RAISES_M = (CUBE_EDGE_M + 0.003,)


def tower_push(trial: ControlTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    spare = [name for name in trial.cargo() if name not in trial.goal.entities]
    near = [name for name in spare if _is_home(trial, name)]
    on = trial.goal.conjuncts[0]
    farthest_m = trial.could.touch_m + HANDLE_LENGTH_M + 2.0 * CUBE_EDGE_M
    pad = trial.pose(on.bottom)
    if not near or not kind_of(on.bottom).fixed or trial.radius(pad) > farthest_m:
        raise GiveUp
    if not _is_home(trial, on.top) and not hook_home(trial, on.top):
        return
    spot = base_to(trial, trial.reach.travel_m - 0.09, trial.outward(pad))
    if _build(trial, near[0], on.top, spot):
        climb(trial, on, near[0], _HANDS_M[trial.attempt], _RAISES_M)


def _is_home(trial: ControlTrial, name: str) -> bool:
    return trial.radius(trial.pose(name)) < trial.reach.travel_m - 0.02


def _build(trial: ControlTrial, lower: str, upper: str, spot: Pose2) -> bool:
    """Set down one cube, and the other on it; False if that fails."""
    for name, z in ((lower, CUBE_EDGE_M / 2), (upper, 1.5 * CUBE_EDGE_M)):
        hold = next(holds(trial, name, 0.0, 0.0), None)
        put = leaning(spot.x, spot.y, z + 0.003, spot.yaw, 0.0)
        if hold is None or not trial.can(put) or not pick_up(trial, hold.hand):
            return False
        if not approach(trial, put, 0.0):
            return False
        let_go(trial, put)
    return trial.height(upper) > CUBE_EDGE_M


ATTACKS.add(
    "tower_push",
    Attack(
        name="tower_push",
        summary="Pushes a tower against a pad, and its upper cube over onto the pad.",
        level="control",
        play=tower_push,
        attempts=len(_HANDS_M),
    ),
)
