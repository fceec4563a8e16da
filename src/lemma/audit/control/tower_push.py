"""A tower as a step: push it against a pad with the stick, then push its top over."""

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control.climbing import climb
from lemma.audit.control.stick_in_hand import hook_home, require_stick
from lemma.audit.control_trial import ControlTrial
from lemma.audit.handling import base_to, is_home, set_down
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
    near = [name for name in spare if is_home(trial, name)]
    on = trial.goal.conjuncts[0]
    farthest_m = trial.could.touch_m + HANDLE_LENGTH_M + 2.0 * CUBE_EDGE_M
    pad = trial.pose(on.bottom)
    if not near or not kind_of(on.bottom).fixed or trial.radius(pad) > farthest_m:
        raise GiveUp
    if not is_home(trial, on.top) and not hook_home(trial, on.top):
        return
    spot = base_to(trial, trial.reach.travel_m - 0.09, trial.outward(pad))
    if _build(trial, near[0], on.top, spot):
        climb(trial, on, near[0], _HANDS_M[trial.attempt], _RAISES_M)


def _build(trial: ControlTrial, lower: str, upper: str, spot: Pose2) -> bool:
    """Set down one cube, and the other on it; False if that fails."""
    built = set_down(trial, lower, spot) and set_down(trial, upper, spot, CUBE_EDGE_M)
    return built and trial.height(upper) > CUBE_EDGE_M


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
