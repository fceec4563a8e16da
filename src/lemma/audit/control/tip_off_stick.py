"""The stick as a tray: carry a cube on it over a pad, and get rid of the cube there."""

import math
from collections.abc import Iterator

from lemma.audit.attack import ATTACKS, Attack, GiveUp, Lost
from lemma.audit.control.handling import approach, base_to, holds, let_go, pick_up
from lemma.audit.control.stick_in_hand import (
    either_way,
    grasp_stick,
    hand_at,
    hook_home,
    lay_stick,
    require_stick,
)
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import leaning, moved, turned
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    STICK_GRASP_HEIGHT_M,
    STICK_SECTION_M,
)
from lemma.tasks.goal import On

_SPOT = Pose2(HANDLE_LENGTH_M - STICK_SECTION_M / 2, 0.035)
"""Where on the stick the cube lies."""
_HANDS_M = (0.42, 0.30, 0.20)
"""Where along the handle the stick is held then, by attempt."""
_CARRY_M = 0.10
_SLOW = 0.12
_AIMS_M = (0.0, 0.03, 0.06, 0.09)
_TIPS_RAD = (0.5, -0.5)


def tip_off_stick(trial: ControlTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    for on in trial.goal.conjuncts:
        farthest = trial.could.touch_m + HANDLE_LENGTH_M
        if trial.radius(trial.pose(on.bottom)) > farthest:
            raise GiveUp
    for on in trial.goal.conjuncts:
        if not _load(trial, on) or not _carry(trial, on):
            return


def _load(trial: ControlTrial, on: On) -> bool:
    """Lay the stick across the front, and the cube on it; False if that fails."""
    home = trial.reach.travel_m - 0.03
    if trial.radius(trial.pose(on.top)) > home and not hook_home(trial, on.top):
        return False
    grasp = Pose2(0.35, 0.0)
    if trial.radius(trial.pose(STICK) @ _SPOT) > home:
        if not grasp_stick(trial, grasp):
            return False
        if not lay_stick(trial, grasp, _across(trial, grasp)):
            return False
    hold = next(holds(trial, on.top, 0.0, 0.0), None)
    if hold is None or not pick_up(trial, hold.hand):
        return False
    spot = trial.pose(STICK) @ _SPOT
    yaw = spot.yaw + 0.5 * math.pi * round(
        wrap(trial.outward(spot) - spot.yaw) / (0.5 * math.pi)
    )
    z = STICK_SECTION_M + kind_of(on.top).origin_m + 0.002
    put = leaning(spot.x, spot.y, z, yaw, 0.0)
    if not trial.can(put) or not approach(trial, put, 0.0):
        return False
    let_go(trial, put)
    return trial.height(on.top) > STICK_SECTION_M


def _across(trial: ControlTrial, grasp: Pose2) -> Pose2:
    """Return where the stick lies across the robot's front, its head in reach."""
    base = trial.placement.base
    side = -1.0 if trial.outward(trial.pose(STICK)) < base.yaw else 1.0
    grip = base_to(trial, 0.62 * trial.reach.travel_m, base.yaw + side * 0.5)
    turned_grip = Pose2(grip.x, grip.y, base.yaw - side * 0.5 * math.pi)
    return turned_grip @ grasp.inverse()


def _carry(trial: ControlTrial, on: On) -> bool:
    """Lift stick and cube, bring them over the pad, and try ways to leave it there."""
    grasp = Pose2(_HANDS_M[trial.attempt], 0.0)
    if not grasp_stick(trial, grasp):
        return False
    flipped = _is_flipped(trial, grasp)
    up = moved(trial.hand(), dz=_CARRY_M)
    if not trial.lead([up], 0.0, 0.08):
        return False
    start = trial.snapshot()
    for aim_m in _AIMS_M:
        trial.restore(start)
        over = _over(trial, on, grasp, aim_m, flipped)
        if over is None or not trial.go(over, 0.0, _SLOW):
            continue
        loaded = trial.snapshot()
        for path, speed in _endings(trial, over):
            trial.restore(loaded)
            try:
                for hand in path:
                    trial.go(hand, 0.0, speed)
                trial.wait(1.2, 0.0)
            except Lost:
                continue
    return False


def _is_flipped(trial: ControlTrial, grasp: Pose2) -> bool:
    grip = trial.pose(STICK) @ grasp
    return either_way(trial, grip) != grip


def _over(
    trial: ControlTrial, on: On, grasp: Pose2, aim_m: float, flipped: bool
) -> FloatArray | None:
    """Return the hand that has the cube over its pad, or a little beyond."""
    pad = trial.pose(on.bottom)
    local = trial.pose(STICK).inverse() @ trial.pose(on.top)
    height = kind_of(on.bottom).height_m + STICK_GRASP_HEIGHT_M + 0.012
    out = trial.outward(pad)
    for turn in range(-8, 9):
        yaw = out + 0.12 * turn
        x, y = pad.x + aim_m * math.cos(yaw), pad.y + aim_m * math.sin(yaw)
        grip = Pose2(x, y, yaw) @ Pose2(-local.x, -local.y) @ grasp
        hand = hand_at(grip, height)
        if flipped:
            hand = turned(hand, 2, math.pi)
        if trial.can(hand, moved(hand, dz=0.05)):
            return hand
    return None


def _endings(
    trial: ControlTrial, over: FloatArray
) -> Iterator[tuple[list[FloatArray], float]]:
    """Yield ways to get rid of the cube, as poses of the hand, and how fast."""
    base = trial.placement.base
    way = math.atan2(base.y - over[1, 3], base.x - over[0, 3])
    for back_m in (0.12, 0.2):
        jerk = moved(over, back_m * math.cos(way), back_m * math.sin(way))
        yield [jerk], 1.6
    for tip in _TIPS_RAD:
        tipped = turned(over, 0, tip)
        yield [tipped], 0.15
        yield [tipped], 1.6


ATTACKS.add(
    "tip_off_stick",
    Attack(
        name="tip_off_stick",
        summary="Carries a cube on the stick over its pad, and tips or jerks it off.",
        level="control",
        play=tip_off_stick,
        attempts=len(_HANDS_M),
    ),
)
