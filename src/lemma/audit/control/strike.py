"""Strike a cube with the stick, so that it jumps or tumbles over its pad's edge."""

from lemma.audit.attack import ATTACKS, Attack, GiveUp, Lost
from lemma.audit.control.climbing import ahead_of, push_against
from lemma.audit.control.stick_in_hand import require_stick
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import moved
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M

_SHOTS = ((0.45, 0.03), (0.25, 0.08), (0.25, 0.2))
"""Where along the handle the stick is held, and how far short of the pad the cube is
then; by attempt [m]."""
_SWING_M = 0.12
_RAISES_M = (0.0, 0.015, 0.03)
_SPEEDS_M_S = (0.8, 1.4, 2.2)
_ROLL_S = 1.2


def strike(trial: ControlTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    longest_m = HANDLE_LENGTH_M + 2.0 * CUBE_EDGE_M
    on = trial.goal.conjuncts[0]
    far = trial.radius(trial.pose(on.bottom)) > trial.could.touch_m + longest_m
    if far or len(trial.goal.conjuncts) > 1 or not kind_of(on.bottom).fixed:
        raise GiveUp
    hand_m, short_m = _SHOTS[trial.attempt]
    way = push_against(trial, on, on.top, hand_m, short_m)
    if way is None:
        return
    at = ahead_of(way.end, way, -short_m)
    ready = trial.snapshot()
    for raise_m in _RAISES_M:
        back = moved(ahead_of(at, way, -_SWING_M), dz=raise_m)
        through = moved(ahead_of(at, way, short_m + 0.02), dz=raise_m)
        for speed in _SPEEDS_M_S:
            trial.restore(ready)
            try:
                if not trial.lead([back], 0.0, 0.15):
                    continue
                trial.lead([through], 0.0, speed)
                trial.wait(_ROLL_S, 0.0)
                trial.lead([back], 0.0, 0.15)
                trial.wait(_ROLL_S, FINGER_OPENING_M)
            except Lost:
                continue


ATTACKS.add(
    "strike",
    Attack(
        name="strike",
        summary="Strikes a cube with the stick, so that it jumps onto its pad.",
        level="control",
        play=strike,
        attempts=len(_SHOTS),
    ),
)
