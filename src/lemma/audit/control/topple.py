"""Push a cube against its pad with the stick, and topple it over the pad's edge."""

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control.climbing import climb
from lemma.audit.control.stick_in_hand import require_stick
from lemma.audit.control_trial import ControlTrial
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M

_HANDS_M = (0.45, 0.25, 0.06)
"""Where along the handle the stick is held, by attempt."""
_RAISES_M = (0.03, 0.036, 0.042, 0.048)
"""Above the middle of the cube, and still below its top."""


def topple(trial: ControlTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    longest_m = HANDLE_LENGTH_M + 2.0 * CUBE_EDGE_M
    for on in trial.goal.conjuncts:
        near = trial.radius(trial.pose(on.bottom)) < trial.could.touch_m + longest_m
        if not near or not kind_of(on.bottom).fixed:
            raise GiveUp
    for on in trial.goal.conjuncts:
        climb(trial, on, on.top, _HANDS_M[trial.attempt], _RAISES_M)


ATTACKS.add(
    "topple",
    Attack(
        name="topple",
        summary="Pushes a cube against its pad with the stick, and topples it onto it.",
        level="control",
        play=topple,
        attempts=len(_HANDS_M),
    ),
)
