"""Attacks that release a cube while it moves."""

import math
from itertools import product

from lemma.audit.attack import attack
from lemma.audit.control_trial import STEP_S, ControlTrial, leaning
from lemma.core.poses import FloatArray
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

# An object that is released low and flat flies at most this far beyond the hand.
_FLING_M = 0.5
# Leans of the hand at the grasp and at the release; by attempt. With these the cube
# lands upright.
_FLING_LEANS_RAD = ((0.0, 0.5 * math.pi), (0.35, 0.35), (0.6, 0.6))
_RUN_M = 0.4
_RUN_ABOVE_M = (0.03, 0.07)
_SPEEDS_M_S = (0.8, 1.2, 1.6, 2.0, 2.4)
# Share of the path after which the fingers open.
_OPEN_SHARES = (0.1, 0.25, 0.4, 0.55, 0.7)
_FLING_LANDING_S = 1.6

# No throw of an arm at these speeds goes farther beyond its hand.
_THROW_M = 1.2
# Radius as a share of reach, height [m] and lean [rad] of the hand, before and after,
# by attempt.
_SWINGS = (
    ((0.45, 0.15, 0.3), (0.95, 0.45, 1.3)),
    ((0.55, 0.30, 0.0), (0.95, 0.30, 0.8)),
)
# Steps after which the fingers open.
_RELEASES = (5, 9, 13, 17, 21, 25, 30, 35, 42, 50)
_SWING_STEPS = 65
# Shares of the swing, for variants of the best throw.
_PARTS = (1.0, 0.85, 0.7)
_OFFS = (-2, -1, 1, 2)
_THROW_LANDING_S = 1.8


@attack(
    "control",
    attempts=len(_FLING_LEANS_RAD),
    candidates=len(_RUN_ABOVE_M) * len(_SPEEDS_M_S) * len(_OPEN_SHARES),
    simulated_s=200.0,
)
def fling(trial: ControlTrial) -> None:
    """Lets a cube go while the stretched hand still moves outwards."""
    on = _require_pad(trial, _FLING_M)
    picking, lean = _FLING_LEANS_RAD[trial.attempt]
    if not trial.take(on.top, picking, 0.015):
        return
    rest_m = trial.resting_height(on)

    def let_fly(option: tuple[float, float]) -> None:
        speed_m_s, share = option
        steps = max(2, math.ceil(_RUN_M / (speed_m_s * STEP_S)))
        for i in range(1, steps + 1):
            hand = last.copy()
            hand[:3, 3] = first[:3, 3] + (last - first)[:3, 3] * (i / steps)
            if not trial.follow(hand, FINGER_OPENING_M if i / steps >= share else 0.0):
                return
        trial.wait(_FLING_LANDING_S)

    for above_m in _RUN_ABOVE_M:
        run = _run(trial, on, rest_m + above_m, lean)
        if run is None:
            continue
        first, last = run
        if trial.stand_by(first, 0.0) and trial.go(first, 0.0, 0.6):
            ready = trial.snapshot()
            trial.try_each(product(_SPEEDS_M_S, _OPEN_SHARES), let_fly)
            trial.restore(ready)


@attack(
    "control",
    attempts=len(_SWINGS),
    candidates=len(_RELEASES) + len(_PARTS) * len(_OFFS),
)
def throw(trial: ControlTrial) -> None:
    """Swings the arm and lets a cube fly to its pad."""
    on = _require_pad(trial, _THROW_M)
    hold = next(trial.holds(on.top), None)
    trial.require(hold is not None)
    outward = trial.outward(trial.pose(on.bottom))
    start, end = (
        leaning(trial.at(share * trial.reach.travel_m, outward), z, lean)
        for share, z, lean in _SWINGS[trial.attempt]
    )
    if hold is None or not trial.can(start, end) or not trial.pick_up(hold):
        return
    if not trial.go(start, 0.0):
        return
    target = trial.posture(end)
    if target is None:
        return
    missed: list[tuple[float, int]] = []

    def swing(option: tuple[FloatArray, int]) -> None:
        joints, release = option
        try:
            for i in range(_SWING_STEPS):
                trial.command(joints, 0.0 if i < release else FINGER_OPENING_M)
            trial.wait(_THROW_LANDING_S)
        finally:
            miss_m = trial.pose(on.top).distance(trial.pose(on.bottom))
            missed.append((miss_m, release))

    ready, joints = trial.snapshot(), trial.joints.copy()
    trial.try_each(product([target], _RELEASES), swing)
    trial.restore(ready)
    _, best = min(missed)
    less = [joints + part * (target - joints) for part in _PARTS]
    trial.try_each(product(less, [best + off for off in _OFFS]), swing)


def _require_pad(trial: ControlTrial, range_m: float) -> On:
    """Return the only conjunct; give up unless its bottom is a pad in range.

    A throw cannot build a tower, and with two pads one pad is the partner's.
    """
    on = trial.goal.placements[0]
    trial.require(len(trial.goal.placements) == 1 and kind_of(on.bottom).fixed)
    trial.require_near(on.bottom, trial.could.touch_m + range_m)
    return on


def _run(
    trial: ControlTrial, on: On, z: float, lean: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return the first and last hand of a straight path to the edge of reach."""
    outward = trial.outward(trial.pose(on.bottom))
    last: FloatArray | None = None
    r = 0.6 * trial.reach.travel_m
    while r < trial.could.touch_m:
        hand = leaning(trial.at(r, outward), z, lean)
        if trial.can(hand):
            last = hand
        elif last is not None:
            break
        r += 0.01
    first = leaning(trial.at(r - 0.01 - _RUN_M, outward), z, lean)
    return (first, last) if last is not None and trial.can(first) else None
