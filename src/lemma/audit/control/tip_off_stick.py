"""The stick as a tray: carry a cube on it over a pad, and get rid of the cube there."""

import math
from collections.abc import Iterator

from lemma.audit.attack import ATTACKS, Attack, GiveUp, Lost
from lemma.audit.control.stick_in_hand import (
    either_way,
    grasp_stick,
    hand_at,
    hook_home,
    lay_stick,
    require_stick,
)
from lemma.audit.control_trial import STEP_S, ControlTrial
from lemma.audit.hand import dipping, leaning, moved, turned
from lemma.audit.handling import approach, base_to, holds, let_go, pick_up
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_GRASP_HEIGHT_M,
    STICK_SECTION_M,
)
from lemma.tasks.goal import On

_SPOT = Pose2(HANDLE_LENGTH_M - 0.004, 0.08)
"""Where on the stick the cube lies."""
_HANDS_M = (0.42, 0.30, 0.20, 0.08)
"""Where along the handle the stick is held then, by attempt."""
_CARRY_M = 0.10
_SLOW = 0.12
"""How fast the arm swings [rad/s] or stretches [m/s] with a cube on the stick."""
_JUMP_RAD = 0.3
_AIMS_M = (-0.06, -0.035, -0.01, 0.06)
_PITCHES_RAD = (0.3, 0.42, 0.55)
_DIP_M = 0.025
_PULL_M = 0.15


def tip_off_stick(trial: ControlTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    for on in trial.goal.conjuncts:
        support_m = kind_of(on.bottom).support_m or 0.0
        longest_m = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M) + CUBE_EDGE_M
        farthest_m = trial.could.touch_m + longest_m + support_m
        if trial.radius(trial.pose(on.bottom)) > farthest_m:
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
        if over is None or not _bring(trial, over):
            continue
        loaded = trial.snapshot()
        for path, speed in _endings(trial, over):
            trial.restore(loaded)
            try:
                for hand in path:
                    trial.go(hand, 0.0, speed)
                trial.wait(0.3, 0.0)
                # What is held at the end, the stick too, is no success.
                trial.wait(2.0, FINGER_OPENING_M)
            except Lost:
                continue
    return False


def _bring(trial: ControlTrial, over: FloatArray) -> bool:
    """Bring the hand, pointing down, slowly round its base; False if it cannot."""
    base, start = trial.placement.base, trial.hand()
    at = Pose2(start[0, 3], start[1, 3], math.atan2(start[1, 0], start[0, 0]))
    to = Pose2(over[0, 3], over[1, 3], math.atan2(over[1, 0], over[0, 0]))
    swing = wrap(trial.outward(to) - trial.outward(at))
    # The stick turns with the arm, and by what is left beside.
    twist = wrap(to.yaw - at.yaw - swing)
    further = base.distance(to) - base.distance(at)
    most = max(abs(swing), abs(twist), abs(further), 0.02)
    steps = math.ceil(most / (_SLOW * STEP_S))
    for i in range(1, steps + 1):
        # Gently off and gently to rest.
        t = 0.5 - 0.5 * math.cos(math.pi * i / steps)
        bearing = trial.outward(at) + t * swing
        spot = base_to(trial, base.distance(at) + t * further, bearing)
        joints = trial.posture(
            leaning(spot.x, spot.y, start[2, 3], at.yaw + t * (swing + twist), 0.0)
        )
        if joints is None or float(abs(joints - trial.joints).max()) > _JUMP_RAD:
            return False
        trial.command(joints, 0.0)
    return trial.lead([over], 0.0, 0.05)


def _is_flipped(trial: ControlTrial, grasp: Pose2) -> bool:
    grip = trial.pose(STICK) @ grasp
    return either_way(trial, grip) != grip


def _over(
    trial: ControlTrial, on: On, grasp: Pose2, aim_m: float, flipped: bool
) -> FloatArray | None:
    """Return the hand that has the cube over its pad, or a little beyond."""
    pad = trial.pose(on.bottom)
    local = trial.pose(STICK).inverse() @ trial.pose(on.top)
    height = kind_of(on.bottom).height_m + STICK_GRASP_HEIGHT_M + 0.03
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
    stick = trial.pose(STICK)
    back = moved(
        over, *(-_PULL_M * c for c in (math.cos(stick.yaw), math.sin(stick.yaw)))
    )
    head = stick @ Pose2(HANDLE_LENGTH_M, 0.0)
    for pitch in _PITCHES_RAD:
        # The head dips until it touches; the cube slides down and off.
        z = float(over[2, 3]) - _DIP_M
        dipped = dipping(over, (head.x, head.y, z), stick.yaw, pitch)
        dipped[2, 3] -= _DIP_M
        yield [dipped, moved(dipped, *(back[:3, 3] - over[:3, 3]))], 0.15
    yield [back], 1.6


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
