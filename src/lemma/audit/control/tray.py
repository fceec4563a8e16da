"""The stick as a tray: an attack that carries a cube on it, farther than the hand."""

import math
from collections.abc import Iterator

import numpy as np

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.control.stick import (
    either_way,
    grasp_stick,
    hook_home,
    lay_stick,
    require_stick,
)
from lemma.audit.control_trial import STEP_S, ControlTrial
from lemma.audit.hand import ahead, leaning, moved
from lemma.audit.pushes import LONGEST_M
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    STICK_GRASP_HEIGHT_M,
    STICK_SECTION_M,
)
from lemma.tasks.goal import On

# Where on the stick the cube lies.
_SPOT = Pose2(HANDLE_LENGTH_M - 0.004, 0.08)
# Where along the handle the stick is held then, by attempt.
_HANDS_M = (0.42, 0.30, 0.20, 0.08)
_CARRY_M = 0.10
# Speed of the arm with a cube on the stick [rad/s], [m/s].
_SLOW = 0.12
_JUMP_RAD = 0.3
_AIMS_M = (-0.06, -0.035, -0.01, 0.06)
_PITCHES_RAD = (0.3, 0.42, 0.55)
_DIP_M = 0.025
_PULL_M = 0.15

# Poses of the hand, and its speed as a share of the usual one.
_Ending = tuple[list[FloatArray], float]


def tip_off_stick(trial: ControlTrial) -> None:
    """Carries a cube on the stick over its pad, and tips or jerks it off."""
    require_stick(trial)
    for on in trial.goal.conjuncts:
        beyond_m = LONGEST_M + CUBE_EDGE_M + trial.support_m(on.bottom)
        trial.require_near(on.bottom, trial.could.touch_m + beyond_m)
    # With the stick over one pad nothing is done about another.
    on = trial.goal.conjuncts[0]
    if _load(trial, on):
        _carry(trial, on)


def _load(trial: ControlTrial, on: On) -> bool:
    """Lay the stick across the front, and the cube on it; False if that fails."""
    home_m = trial.reach.travel_m - 0.03
    if trial.radius(trial.pose(on.top)) > home_m and not hook_home(trial, on.top):
        return False
    grasp = Pose2(0.35, 0.0)
    if trial.radius(trial.pose(STICK) @ _SPOT) > home_m:
        if not grasp_stick(trial, grasp):
            return False
        if not lay_stick(trial, grasp, _across(trial, grasp)):
            return False
    if not trial.take(on.top):
        return False
    spot = trial.pose(STICK) @ _SPOT
    quarters = round(wrap(trial.outward(spot) - spot.yaw) / (0.5 * math.pi))
    turned = Pose2(spot.x, spot.y, spot.yaw + 0.5 * math.pi * quarters)
    z = STICK_SECTION_M + kind_of(on.top).origin_m + 0.002
    put = leaning(turned, z)
    if not trial.can(put) or not trial.put(put):
        return False
    return trial.height(on.top) > STICK_SECTION_M


def _across(trial: ControlTrial, grasp: Pose2) -> Pose2:
    """Return where the stick lies across the robot's front, its head in reach."""
    yaw = trial.placement.base.yaw
    side = -1.0 if trial.outward(trial.pose(STICK)) < yaw else 1.0
    grip = trial.at(0.62 * trial.reach.travel_m, yaw + side * 0.5)
    return Pose2(grip.x, grip.y, yaw - side * 0.5 * math.pi) @ grasp.inverse()


def _carry(trial: ControlTrial, on: On) -> None:
    """Lift stick and cube, bring them over the pad, and try ways to leave it there."""
    grasp = Pose2(_HANDS_M[trial.attempt], 0.0)
    if not grasp_stick(trial, grasp):
        return
    grip = trial.pose(STICK) @ grasp
    flipped = either_way(trial, grip) != grip
    if not trial.lead([moved(trial.hand(), dz=_CARRY_M)], 0.0, 0.08):
        return

    def leave(ending: _Ending) -> None:
        path, speed = ending
        for hand in path:
            trial.go(hand, 0.0, speed)
        trial.wait(0.3, 0.0)
        # Nothing that is held at the end counts, so the stick is let go.
        trial.wait(2.0)

    def bring(aim_m: float) -> None:
        over = _over(trial, on, grasp, aim_m, flipped)
        if over is not None and _bring(trial, over):
            trial.try_each(_endings(trial, over), leave)

    trial.try_each(_AIMS_M, bring)


def _bring(trial: ControlTrial, over: FloatArray) -> bool:
    """Bring the hand, pointing down, slowly round its base; False if it cannot."""
    base, start = trial.placement.base, trial.hand()
    at = Pose2(start[0, 3], start[1, 3], math.atan2(start[1, 0], start[0, 0]))
    to = Pose2(over[0, 3], over[1, 3], math.atan2(over[1, 0], over[0, 0]))
    swing = wrap(trial.outward(to) - trial.outward(at))
    # The stick turns with the arm, and by the rest besides.
    twist = wrap(to.yaw - at.yaw - swing)
    further = base.distance(to) - base.distance(at)
    most = max(abs(swing), abs(twist), abs(further), 0.02)
    steps = math.ceil(most / (_SLOW * STEP_S))
    for i in range(1, steps + 1):
        # Speed rises and falls gently.
        t = 0.5 - 0.5 * math.cos(math.pi * i / steps)
        bearing = trial.outward(at) + t * swing
        spot = trial.at(base.distance(at) + t * further, bearing)
        way = Pose2(spot.x, spot.y, at.yaw + t * (swing + twist))
        joints = trial.posture(leaning(way, start[2, 3]))
        if joints is None or float(abs(joints - trial.joints).max()) > _JUMP_RAD:
            return False
        trial.command(joints, 0.0)
    return trial.lead([over], 0.0, 0.05)


def _over(
    trial: ControlTrial, on: On, grasp: Pose2, aim_m: float, flipped: bool
) -> FloatArray | None:
    """Return the hand that has the cube over its pad, or a little beyond."""
    pad = trial.pose(on.bottom)
    local = trial.pose(STICK).inverse() @ trial.pose(on.top)
    height = kind_of(on.bottom).height_m + STICK_GRASP_HEIGHT_M + 0.03
    outward = trial.outward(pad)
    for turn in range(-8, 9):
        yaw = outward + 0.12 * turn
        x, y = pad.x + aim_m * math.cos(yaw), pad.y + aim_m * math.sin(yaw)
        grip = Pose2(x, y, yaw) @ Pose2(-local.x, -local.y) @ grasp
        hand = leaning(grip, height)
        if flipped:
            hand = _turned(hand, math.pi)
        if trial.can(hand, moved(hand, dz=0.05)):
            return hand
    return None


def _endings(trial: ControlTrial, over: FloatArray) -> Iterator[_Ending]:
    """Yield ways to get rid of the cube."""
    stick = trial.pose(STICK)
    back = ahead(over, -_PULL_M, stick.yaw)
    head = stick @ Pose2(HANDLE_LENGTH_M, 0.0)
    for pitch in _PITCHES_RAD:
        # The head dips until it touches; the cube slides down and off.
        z = float(over[2, 3]) - _DIP_M
        dipped = _dipping(over, (head.x, head.y, z), stick.yaw, pitch)
        dipped[2, 3] -= _DIP_M
        yield [dipped, moved(dipped, *(back[:3, 3] - over[:3, 3]))], 0.15
    yield [back], 1.6


def _turned(hand: FloatArray, angle: float) -> FloatArray:
    """Return a hand turned about the direction of its fingers by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    pose = hand.copy()
    pose[:3, 0] = c * hand[:3, 0] + s * hand[:3, 1]
    pose[:3, 1] = c * hand[:3, 1] - s * hand[:3, 0]
    return pose


def _dipping(
    hand: FloatArray, point: tuple[float, float, float], heading: float, angle: float
) -> FloatArray:
    """Return a hand turned about a point, so that the end of the held stick dips.

    Args:
        hand: The hand, (4, 4).
        point: The point, which stays where it is [m].
        heading: Direction of the stick, seen from above [rad].
        angle: By which that end goes down [rad].
    """
    c, s = math.cos(angle), math.sin(angle)
    x, y = math.cos(heading), math.sin(heading)
    along, aside = np.array([x, y, 0.0]), np.array([-y, x, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    rotation = (
        np.outer(c * along - s * up, along)
        + np.outer(aside, aside)
        + np.outer(c * up + s * along, up)
    )
    pose = hand.copy()
    pose[:3, :3] = rotation @ hand[:3, :3]
    pose[:3, 3] = rotation @ (hand[:3, 3] - point) + point
    return pose


ATTACKS.add("tip_off_stick", Attack(tip_off_stick, "control", attempts=len(_HANDS_M)))
