"""An attack by optimization: cross-entropy search over motor commands."""

import math
from contextlib import suppress

import numpy as np

from lemma.audit.attack import attack
from lemma.audit.control_trial import ControlTrial, drawn_back, leaning
from lemma.audit.trial import Lost
from lemma.core.poses import FloatArray
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.ur.arms import ARMS

# The search ends if the goal is farther beyond the hand.
_BEYOND_M = 0.40
_LEANS_RAD = (0.5 * math.pi, 1.2, 0.8, 0.4, 0.0)
# Height of the hand at the start of the search [m], by attempt.
_HEIGHTS_M = (0.12, 0.30)
# Distance of the hand behind a cube, and above the table.
_BEHIND_M, _STRIKE_M = 0.06, 0.03
_ROUNDS, _DRAWS, _BEST = 5, 10, 3
_KNOTS = 4
_MOVING_STEPS, _LANDING_STEPS = 40, 25
# Standard deviations of the joint angles at the knots [rad], and of the step at which
# the fingers open.
_SPREAD_RAD = np.array([0.15, 0.35, 0.35, 0.45, 0.3, 0.3])
_SPREAD_STEPS = 8.0
_LEAST_SHARE = 0.1
_THROWN_M = 0.3
_NEAR_M = 0.06


@attack(
    "control",
    attempts=len(_HEIGHTS_M) + 1,
    candidates=_ROUNDS * _DRAWS,
    simulated_s=150.0,
)
def search(trial: ControlTrial) -> None:
    """Searches motor commands that bring a cube nearest to its goal.

    It starts with the cube in the hand, stretched towards the goal low (first attempt)
    or high (second), or with the cube on the table in front of the stretched hand
    (third). A cross-entropy search draws 5 times 10 trajectories: four angles of each
    of the six joints over 0.8 s, and the step at which the fingers open. Each is played
    for 1.3 s. A throw costs 30 cm more.
    """
    on = trial.goal.placements[0]
    trial.require(len(trial.goal.placements) == 1)
    trial.require_near(on.bottom, trial.could.touch_m + _BEYOND_M)
    hold = next(trial.holds(on.top), None)
    strikes = trial.attempt == len(_HEIGHTS_M)
    start = None if strikes else _stretched(trial, _HEIGHTS_M[trial.attempt])
    trial.require(hold is not None and (strikes or start is not None))
    assert hold is not None
    if start is not None:
        if not trial.pick_up(hold) or not trial.go(start, 0.0, 0.6):
            return
    elif not _lay_before(trial):
        return
    ready, joints = trial.snapshot(), trial.joints.copy()
    limits = np.array(ARMS[trial.placement.arm].joint_range)
    middle = np.zeros(_KNOTS * 6 + 1)
    middle[-1] = 0.6 * _MOVING_STEPS
    spread = np.append(np.tile(_SPREAD_RAD, _KNOTS), _SPREAD_STEPS)
    least = _LEAST_SHARE * spread

    def miss_m(course: FloatArray) -> float:
        trial.restore(ready)
        knots = np.vstack([np.zeros(6), course[:-1].reshape(_KNOTS, 6)])
        at = np.linspace(0.0, _KNOTS, _MOVING_STEPS)
        thrown_m = _THROWN_M
        with suppress(Lost):
            for i in range(_MOVING_STEPS + _LANDING_STEPS):
                k = min(i, _MOVING_STEPS - 1)
                turned = [
                    np.interp(at[k], range(_KNOTS + 1), knots[:, j]) for j in range(6)
                ]
                opens = i >= course[-1] and not strikes
                opening_m = FINGER_OPENING_M if opens else 0.0
                trial.command(np.clip(joints + turned, -limits, limits), opening_m)
            if _distance_m(trial) < _NEAR_M:
                trial.wait(0.8)
            thrown_m = 0.0
        return _distance_m(trial) + thrown_m

    for _ in range(_ROUNDS):
        courses = middle + spread * trial.rng.standard_normal((_DRAWS, len(middle)))
        misses = [miss_m(course) for course in courses]
        best = courses[np.argsort(misses, kind="stable")[:_BEST]]
        middle, spread = best.mean(axis=0), np.maximum(best.std(axis=0), least)


def _lay_before(trial: ControlTrial) -> bool:
    """Set the cube down far out, the closed hand behind it; False if that fails."""
    on = trial.goal.placements[0]
    bearing = trial.outward(trial.pose(on.bottom))
    far = trial.at(trial.reach.grasp_m - 0.01, bearing)
    if not trial.set_down(on.top, far):
        return False
    behind = trial.at(trial.radius(trial.pose(on.top)) - _BEHIND_M, bearing)
    for lean in (0.8, 0.4, 0.0):
        hand = leaning(behind, _STRIKE_M, lean)
        if trial.can(hand, drawn_back(hand, 0.10)):
            return trial.approach(hand, 0.0)
    return False


def _distance_m(trial: ControlTrial) -> float:
    """Return the distance of the goal's top from its place on the bottom [m]."""
    on = trial.goal.placements[0]
    away_m = trial.pose(on.top).distance(trial.pose(on.bottom))
    return math.hypot(away_m, trial.height(on.top) - trial.resting_height(on))


def _stretched(trial: ControlTrial, height_m: float) -> FloatArray | None:
    """Return the hand that reaches farthest towards the goal at a height."""
    target = trial.pose(trial.goal.placements[0].bottom)
    bearing, farthest_m = trial.outward(target), trial.could.touch_m
    nearest_m = 0.5 * trial.reach.travel_m
    for r in np.arange(min(farthest_m, trial.radius(target)), nearest_m, -0.02):
        for lean in _LEANS_RAD:
            hand = leaning(trial.at(float(r), bearing), height_m, lean)
            if trial.can(hand):
                return hand
    return None
