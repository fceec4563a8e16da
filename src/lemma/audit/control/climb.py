"""Attacks that bring a cube over the edge of its pad with the stick."""

from itertools import product

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.control.stick import fetch, push_against, require_stick
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import ahead, moved
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M
from lemma.tasks.goal import On

_LONGEST_M = HANDLE_LENGTH_M + 2.0 * CUBE_EDGE_M
_BACK_M = 0.02
_AWAY_M = 0.15
_OVERS_M = (0.0, 0.02, -0.02, 0.04)
_PUSH_M_S = 0.10
# Where along the handle the stick is held, by attempt.
_TOPPLE_HANDS_M = (0.45, 0.25, 0.06)
# Above the middle of the cube, and still below its top.
_TOPPLE_RAISES_M = (0.03, 0.036, 0.042, 0.048)
_TOWER_HANDS_M = (0.45, 0.30, 0.15)
# Where along the handle the stick is held, and the distance from the cube to the pad
# before the stroke; by attempt [m].
_SHOTS = ((0.45, 0.03), (0.25, 0.08), (0.25, 0.2))
_SWING_M = 0.12
_STROKE_RAISES_M = (0.0, 0.015, 0.03)
_SPEEDS_M_S = (0.8, 1.4, 2.2)
_ROLL_S = 1.2


def topple(trial: ControlTrial) -> None:
    """Pushes a cube against its pad with the stick, and topples it onto it."""
    for on in trial.goal.conjuncts:
        _require_pad(trial, on)
    for on in trial.goal.conjuncts:
        hand_m = _TOPPLE_HANDS_M[trial.attempt]
        _push_over(trial, on, on.top, hand_m, _TOPPLE_RAISES_M)


def tower_push(trial: ControlTrial) -> None:
    """Pushes a tower against a pad, and its upper cube over onto the pad."""
    on = trial.goal.conjuncts[0]
    _require_pad(trial, on)
    near = [name for name in trial.spare() if trial.is_home(name)]
    trial.require(near)
    if not fetch(trial, on.top):
        return
    pad = trial.pose(on.bottom)
    spot = trial.at(trial.reach.travel_m - 0.09, trial.outward(pad))
    stands = trial.set_down(near[0], spot) and trial.set_down(on.top, spot, CUBE_EDGE_M)
    if stands and trial.height(on.top) > CUBE_EDGE_M:
        hand_m = _TOWER_HANDS_M[trial.attempt]
        _push_over(trial, on, near[0], hand_m, (CUBE_EDGE_M + 0.003,))


def strike(trial: ControlTrial) -> None:
    """Strikes a cube with the stick, so that it jumps onto its pad."""
    on = trial.goal.conjuncts[0]
    _require_pad(trial, on)
    trial.require(len(trial.goal.conjuncts) == 1)
    hand_m, short_m = _SHOTS[trial.attempt]
    way = push_against(trial, on, on.top, hand_m, short_m)
    if way is None:
        return
    ready = way.beyond(-short_m)

    def blow(option: tuple[float, float]) -> None:
        raise_m, speed_m_s = option
        back = moved(ahead(ready, -_SWING_M, way.heading), dz=raise_m)
        through = moved(ahead(ready, short_m + 0.02, way.heading), dz=raise_m)
        if trial.lead([back], 0.0, 0.15):
            trial.lead([through], 0.0, speed_m_s)
            trial.wait(_ROLL_S, 0.0)
            trial.lead([back], 0.0, 0.15)
            trial.wait(_ROLL_S)

    trial.try_each(product(_STROKE_RAISES_M, _SPEEDS_M_S), blow)


def _require_pad(trial: ControlTrial, on: On) -> None:
    """Give up unless the stick could push a cube against a fixed pad."""
    require_stick(trial)
    trial.require(kind_of(on.bottom).fixed)
    trial.require_near(on.bottom, trial.could.touch_m + _LONGEST_M)


def _push_over(
    trial: ControlTrial,
    on: On,
    lowest: str,
    hand_m: float,
    raises_m: tuple[float, ...],
) -> None:
    """Push against a pad, raise the stick, and push again over it.

    Args:
        trial: The attempt.
        on: Its bottom is the pad.
        lowest: Name of the object that is pushed along the table.
        hand_m: Where along the handle the stick is held [m].
        raises_m: Heights of the stick in the second push [m].
    """
    way = push_against(trial, on, lowest, hand_m)
    if way is None:
        return

    def again(option: tuple[float, float]) -> None:
        raise_m, over_m = option
        back = way.beyond(-_BACK_M)
        raised = moved(back, dz=raise_m)
        pushed = ahead(raised, _BACK_M + way.gap_m + over_m, way.heading)
        away = ahead(raised, -_AWAY_M, way.heading)
        if trial.lead([back, raised, pushed, away], 0.0, _PUSH_M_S):
            # Nothing that is held at the end counts, so the stick is let go.
            trial.wait(2.2)

    trial.try_each(product(raises_m, _OVERS_M), again)


ATTACKS.add("tower_push", Attack(tower_push, "control", attempts=len(_TOWER_HANDS_M)))
ATTACKS.add("topple", Attack(topple, "control", attempts=len(_TOPPLE_HANDS_M)))
ATTACKS.add("strike", Attack(strike, "control", attempts=len(_SHOTS)))
