"""Let go of a cube while the stretched hand still moves: it flies on a little, flat."""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp, Lost
from lemma.audit.control_trial import STEP_S, ControlTrial
from lemma.audit.hand import leaning
from lemma.audit.handling import (
    base_to,
    holds,
    pick_up,
    resting_height,
    stand_by,
)
from lemma.core.poses import FloatArray
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import kind_of

_RANGE_M = 0.5
"""What is let go so low flies no farther beyond the hand."""
_LEANS_RAD = ((0.0, 0.5 * math.pi), (0.35, 0.35), (0.6, 0.6))
"""Of the hand, when it picks and when it lets go; by attempt. What is held stands
upright again."""
_RUN_M = 0.4
_ABOVE_M = (0.03, 0.07)
_SPEEDS_M_S = (0.8, 1.2, 1.6, 2.0, 2.4)
_RELEASES = (0.1, 0.25, 0.4, 0.55, 0.7)
"""Where the fingers open, as a share of the way."""
_LANDING_S = 1.6


def fling(trial: ControlTrial) -> None:
    """Play an attempt: take the cube, and try speeds, heights and releases."""
    on = trial.goal.conjuncts[0]
    if len(trial.goal.conjuncts) > 1 or not kind_of(on.bottom).fixed:
        # Of two conjuncts each robot would have to do one; towers are not flung.
        raise GiveUp
    pad = trial.pose(on.bottom)
    if trial.radius(pad) > trial.could.touch_m + _RANGE_M:
        raise GiveUp
    picking, lean = _LEANS_RAD[trial.attempt]
    hold = next(holds(trial, on.top, picking, 0.015), None)
    if hold is None or not pick_up(trial, hold.hand):
        return
    outward = trial.outward(pad)
    for above_m in _ABOVE_M:
        z = resting_height(trial, on.top, on.bottom) + above_m
        run = _run(trial, outward, z, lean)
        if run is None or not trial.go(stand_by(trial, run[0]), 0.0):
            continue
        if not trial.go(run[0], 0.0, 0.6):
            continue
        ready = trial.snapshot()
        for speed in _SPEEDS_M_S:
            for release in _RELEASES:
                trial.restore(ready)
                try:
                    _let_fly(trial, run, speed, release)
                except Lost:
                    continue
        trial.restore(ready)


def _run(
    trial: ControlTrial, outward: float, z: float, lean: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return where the hand begins and ends: at the edge of what it reaches."""
    last: FloatArray | None = None
    r = 0.6 * trial.reach.travel_m
    while r < trial.could.touch_m:
        at = base_to(trial, r, outward)
        hand = leaning(at.x, at.y, z, outward, lean)
        if trial.can(hand):
            last = hand
        elif last is not None:
            break
        r += 0.01
    if last is None:
        return None
    at = base_to(trial, r - 0.01 - _RUN_M, outward)
    first = leaning(at.x, at.y, z, outward, lean)
    return (first, last) if trial.can(first) else None


def _let_fly(
    trial: ControlTrial,
    run: tuple[FloatArray, FloatArray],
    speed: float,
    release: float,
) -> None:
    first, last = run
    steps = max(2, math.ceil(_RUN_M / (speed * STEP_S)))
    for i in range(1, steps + 1):
        hand = last.copy()
        hand[:3, 3] = first[:3, 3] + (last[:3, 3] - first[:3, 3]) * (i / steps)
        joints = trial.posture(hand)
        if joints is None:
            return
        trial.command(joints, FINGER_OPENING_M if i / steps >= release else 0.0)
    trial.wait(_LANDING_S, FINGER_OPENING_M)


ATTACKS.add(
    "fling",
    Attack(
        name="fling",
        summary="Lets a cube go while the stretched hand still moves outwards.",
        level="control",
        play=fling,
        attempts=len(_LEANS_RAD),
    ),
)
