"""Throw a cube at its pad: swing the arm, open the fingers on the way."""

from lemma.audit.attack import ATTACKS, Attack, GiveUp, Lost
from lemma.audit.control_trial import ControlTrial, Moment
from lemma.audit.hand import leaning
from lemma.audit.handling import base_to, holds, pick_up
from lemma.core.poses import FloatArray
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_RANGE_M = 1.2
"""No throw of an arm with these speeds goes farther beyond its hand."""
_SWINGS = (
    ((0.45, 0.15, 0.3), (0.95, 0.45, 1.3)),
    ((0.55, 0.30, 0.0), (0.95, 0.30, 0.8)),
)
"""Radius as a share of reach, height [m] and lean [rad] of the hand, before and
after, by attempt."""
_RELEASES = (5, 9, 13, 17, 21, 25, 30, 35, 42, 50)
"""Steps after which the fingers open."""
_STEPS = 65
_SHARES = (1.0, 0.85, 0.7)
"""Of the swing, for throws about the best one."""
_OFFS = (-2, -1, 1, 2)
_LANDING_S = 1.8


def throw(trial: ControlTrial) -> None:
    """Play an attempt: take the cube, and try all releases of one swing."""
    on = trial.goal.conjuncts[0]
    if len(trial.goal.conjuncts) > 1 or not kind_of(on.bottom).fixed:
        # A tower is not built by throwing; two pads take a throw each, one of which
        # would have to be the partner's.
        raise GiveUp
    if trial.radius(trial.pose(on.bottom)) > trial.could.touch_m + _RANGE_M:
        raise GiveUp
    hold = next(holds(trial, on.top, 0.0, 0.0), None)
    if hold is None:
        raise GiveUp
    start, end = _swing(trial, on)
    if start is None or end is None or not pick_up(trial, hold.hand):
        return
    if not trial.go(start, 0.0):
        return
    target = trial.posture(end)
    if target is None:
        return
    ready = trial.snapshot()
    missed = [
        (_throw(trial, on, ready, target, release), release) for release in _RELEASES
    ]
    _, best = min(missed)
    for share in _SHARES:
        for off in _OFFS:
            trial.restore(ready)
            less = trial.joints + share * (target - trial.joints)
            _throw(trial, on, ready, less, best + off)


def _throw(
    trial: ControlTrial, on: On, ready: Moment, target: FloatArray, release: int
) -> float:
    """Swing and open the fingers; return by how much the cube misses [m]."""
    trial.restore(ready)
    try:
        for i in range(_STEPS):
            trial.command(target, 0.0 if i < release else FINGER_OPENING_M)
        trial.wait(_LANDING_S, FINGER_OPENING_M)
    except Lost:
        pass
    return trial.pose(on.top).distance(trial.pose(on.bottom))


def _swing(trial: ControlTrial, on: On) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the hand before and after the swing, None where it cannot be."""
    outward = trial.outward(trial.pose(on.bottom))
    hands = []
    for share, z, lean in _SWINGS[trial.attempt]:
        at = base_to(trial, share * trial.reach.travel_m, outward)
        hand = leaning(at.x, at.y, z, outward, lean)
        hands.append(hand if trial.can(hand) else None)
    return hands[0], hands[1]


ATTACKS.add(
    "throw",
    Attack(
        name="throw",
        summary="Swings the arm and lets a cube fly to its pad.",
        level="control",
        play=throw,
        attempts=len(_SWINGS),
    ),
)
