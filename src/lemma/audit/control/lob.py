"""An attack that throws a cube steeply, and corrects its aim."""

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import numpy as np

from lemma.audit.attack import attack
from lemma.audit.control.stick import hook_home, require_stick
from lemma.audit.control_trial import STEP_S, ControlTrial, leaning
from lemma.audit.trial import Lost
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.env.control.motor_commands import ACCELERATION_RAD_S2
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.ur.arms import ARMS
from lemma.scene.build import TIME_STEP_S
from lemma.tasks.goal import On

# A lob is tried up to this distance beyond the hand.
_LOB_M = 0.7
# Shoulder, elbow and first wrist joint at the release.
_SHOULDERS_RAD = np.linspace(-2.4, 0.0, 13)
_ELBOWS_RAD = np.linspace(-2.4, 2.4, 17)
_WRISTS_RAD = np.linspace(-math.pi, math.pi, 12, endpoint=False)
_RISES_M_S = np.array([0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 2.4, 2.7])
_SHARE_OF_SPEED = 0.93
_RAMP_RAD_S2 = 9.5
_LOWEST_M = 0.10
# A cube with a larger horizontal speed slides off its pad.
_LEVEL_M_S = 1.8
_LOBS, _CORRECTIONS = 4, 7
_LOB_LANDING_S = 1.4
_G_M_S2 = 9.81
_NEAR_M = 0.06
_FUTILE = 2
_SLIGHTLY = 0.03


@dataclass(frozen=True, slots=True)
class _Lob:
    """The state of an arm that releases a rising cube."""

    poor: float
    """Cost: horizontal speed [m/s], which friction must stop, plus tilt [rad]."""
    joints: FloatArray
    rates: FloatArray
    position: FloatArray
    velocity: FloatArray

    def lands(self, rest_m: float, share: float = 1.0) -> Pose2:
        """Return where the cube comes down, thrown with a share of the speed."""
        vx, vy, vz = (share * self.velocity).tolist()
        fall_s = _fall_s(self.position[2] - rest_m, vz)
        return Pose2(self.position[0] + vx * fall_s, self.position[1] + vy * fall_s)


@attack("control", attempts=2, candidates=_LOBS * _CORRECTIONS, simulated_s=150.0)
def lob(trial: ControlTrial) -> None:
    """Throws a cube so steeply that it stays, and corrects its aim shot by shot.

    The place where the cube lands, or would land, corrects the next shot. There are at
    most 4 releases with 7 corrections each; a second attempt adds random errors.
    """
    on = trial.goal.placements[0]
    trial.require(len(trial.goal.placements) == 1)
    trial.require_near(on.bottom, trial.could.touch_m + _LOB_M)
    if not trial.is_home(on.top):
        require_stick(trial)
        if not hook_home(trial, on.top) or not trial.is_home(on.top):
            return
        trial.wait(0.6)
        trial.stand_by(trial.hand(), FINGER_OPENING_M)
    hold = next(trial.holds(on.top), None)
    trial.require(hold is not None)
    target, rest_m = trial.pose(on.bottom), trial.resting_height(on)
    lobs = _lobs(trial, target, rest_m)
    trial.require(lobs)
    if hold is None or not trial.pick_up(hold):
        return
    ready = trial.snapshot()
    for one in lobs[:_LOBS]:
        aim, futile = target, 0
        for _ in range(_CORRECTIONS):
            # The aim is right and the cube is still lost: more corrections are useless.
            if futile == _FUTILE:
                break
            trial.restore(ready)
            error = 1.0 + _SLIGHTLY * trial.attempt * trial.rng.uniform(-1.0, 1.0)
            at, lost = _shoot(trial, _aimed(trial, one, aim, rest_m, error), on)
            futile += lost and at.distance(target) < _NEAR_M
            aim = Pose2(aim.x + target.x - at.x, aim.y + target.y - at.y)


def _lobs(trial: ControlTrial, target: Pose2, rest_m: float) -> list[_Lob]:
    """Return lobs that get as far as the target, the best first."""
    bearing = trial.outward(target)
    level = leaning(trial.at(0.6 * trial.reach.travel_m, bearing), 0.3)
    known = trial.postures(level)
    trial.require(len(known))
    found: list[_Lob] = []
    for angles in product(_SHOULDERS_RAD, _ELBOWS_RAD, _WRISTS_RAD):
        joints = known[0].copy()
        joints[1:4] = angles
        found += _releases(trial, joints, trial.radius(target), rest_m)
    found.sort(key=lambda one: one.poor)
    usable: list[_Lob] = []
    for one in found:
        if len(usable) == _LOBS:
            break
        near = any(float(np.abs(one.joints - u.joints).max()) < 0.3 for u in usable)
        ends = (one.joints, _before(one.joints, one.rates))
        if not near and all(_is_usable(trial, joints) for joints in ends):
            usable.append(one)
    return usable


def _releases(
    trial: ControlTrial, joints: FloatArray, range_m: float, rest_m: float
) -> list[_Lob]:
    """Return lobs from a posture that have a range and should land upright."""
    hand, base = trial.hand_at(joints), trial.placement.base
    if hand[2, 3] < _LOWEST_M:
        return []
    # The three joints move the hand in a vertical plane.
    x, y = math.cos(base.yaw + joints[0]), math.sin(base.yaw + joints[0])
    along = x * (hand[0, 3] - base.x) + y * (hand[1, 3] - base.y)
    across = y * (hand[0, 3] - base.x) - x * (hand[1, 3] - base.y)
    heading, matrix = math.atan2(y, x), np.empty((3, 3))
    for k in range(3):
        turned = joints.copy()
        turned[1 + k] += 1e-4
        after = trial.hand_at(turned)
        dx, dy, dz = (after - hand)[:3, 3]
        lean = wrap(_lean(after, heading) - _lean(hand, heading))
        matrix[:, k] = np.array([x * dx + y * dy, dz, lean]) / 1e-4
    if abs(np.linalg.det(matrix)) < 1e-3:
        return []
    fall_s = np.array([_fall_s(hand[2, 3] - rest_m, rise) for rise in _RISES_M_S])
    way_m = math.sqrt(max(0.0, range_m**2 - across**2))
    quarter, lean = 0.5 * math.pi, _lean(hand, heading)
    limits = np.array(ARMS[trial.placement.arm].velocity_limits)[1:4]
    found = []
    for way, more in product((way_m, -way_m), range(-4, 5)):
        level = (way - along) / fall_s
        spin = ((round(lean / quarter) + more) * quarter - lean) / fall_s
        rates = np.linalg.solve(matrix, np.stack([level, _RISES_M_S, spin]))
        loads = (np.abs(rates) / limits[:, None]).max(axis=0)
        for i in np.flatnonzero(
            (loads < _SHARE_OF_SPEED) & (np.abs(level) < _LEVEL_M_S)
        ):
            all_rates = np.array([0.0, *rates[:, i], 0.0, 0.0])
            if trial.hand_at(_before(joints, all_rates))[2, 3] < _LOWEST_M:
                continue
            velocity = np.array([level[i] * x, level[i] * y, _RISES_M_S[i]])
            poor = abs(float(level[i])) + 0.05 * abs(float(spin[i]))
            found.append(_Lob(poor, joints, all_rates, hand[:3, 3], velocity))
    return found


def _before(joints: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the angles from which constant acceleration reaches angles and rates."""
    before: FloatArray = joints - 0.5 * rates * np.abs(rates).max() / _RAMP_RAD_S2
    return before


def _is_usable(trial: ControlTrial, joints: FloatArray) -> bool:
    """Whether inverse kinematics returns a posture: it is clear of table and arm."""
    away = trial.postures(trial.hand_at(joints)) - joints
    away -= np.round(away / math.tau) * math.tau
    return bool((np.abs(away).max(axis=1, initial=0.0) < 0.01).any())


def _lean(hand: FloatArray, bearing: float) -> float:
    """Return the angle between the fingers and straight down, outwards [rad]."""
    ahead = hand[0, 2] * math.cos(bearing) + hand[1, 2] * math.sin(bearing)
    return math.atan2(ahead, -hand[2, 2])


def _aimed(
    trial: ControlTrial, one: _Lob, aim: Pose2, rest_m: float, error: float
) -> tuple[FloatArray, FloatArray]:
    """Return joints and rates of a lob at an aim, with a random error added."""
    low, high = 0.4, 1.06
    while high - low > 1e-3:
        share = 0.5 * (low + high)
        short = trial.radius(one.lands(rest_m, share)) < trial.radius(aim)
        low, high = (share, high) if short else (low, share)
    joints = one.joints.copy()
    joints[0] += trial.outward(aim) - trial.outward(one.lands(rest_m, low))
    return joints, low * error * one.rates


def _shoot(
    trial: ControlTrial, shot: tuple[FloatArray, FloatArray], on: On
) -> tuple[Pose2, bool]:
    """Play a lob; return where the cube comes down, and whether it counts as lost."""
    joints, rates = shot
    steps = math.ceil(float(np.abs(rates).max()) / (_RAMP_RAD_S2 * STEP_S))
    state = trial.episode.simulation.arms[trial.robot].state
    rest_m, at = trial.resting_height(on), trial.pose(on.top)
    with suppress(Lost):
        _turn(trial, joints - 0.5 * rates * steps * STEP_S)
        for i in range(1, steps + 2):
            wanted = rates * min(1.0, i / steps)
            # The reference brakes towards its target. A target at this distance gives
            # the wanted speed at the end of the step.
            gaps = wanted * (np.abs(wanted) / ACCELERATION_RAD_S2 + TIME_STEP_S) / 2.0
            way = 0.5 * (state[1] + wanted) * (STEP_S - TIME_STEP_S)
            opening_m = FINGER_OPENING_M if i >= steps else 0.0
            trial.command(state[0] + way + gaps, opening_m)
        end = state[0] + 0.5 * state[1] * np.abs(state[1]) / ACCELERATION_RAD_S2
        flying = True
        for _ in range(round(_LOB_LANDING_S / STEP_S)):
            if flying:
                at, flying = _landing(trial, on.top, rest_m)
            trial.command(end, FINGER_OPENING_M)
        if trial.pose(on.top).distance(trial.pose(on.bottom)) < _NEAR_M:
            trial.wait(1.0)
        return at, False
    return at, True


def _landing(trial: ControlTrial, name: str, rest_m: float) -> tuple[Pose2, bool]:
    """Return where an object lands, and whether it still flies."""
    scene = trial.scene
    dof = scene.model.jnt_dofadr[scene.model.body(name).jntadr[0]]
    vx, vy, vz = scene.data.qvel[dof : dof + 3].tolist()
    now, above = trial.pose(name), trial.height(name) - rest_m
    fall_s = _fall_s(above, vz) if above > 0.0 else 0.0
    return Pose2(now.x + vx * fall_s, now.y + vy * fall_s), above > 0.03


def _fall_s(above_m: float, rise: float) -> float:
    """Return the flight time of an object [s].

    Args:
        above_m: Height of the release above the landing [m].
        rise: Vertical speed at the release [m/s].
    """
    root = math.sqrt(max(0.0, rise * rise + 2.0 * _G_M_S2 * above_m))
    return (rise + root) / _G_M_S2


def _turn(trial: ControlTrial, joints: FloatArray) -> None:
    """Turn the joints to angles at a moderate speed, with closed fingers."""
    start = trial.joints.copy()
    limits = np.array(ARMS[trial.placement.arm].velocity_limits)
    seconds = float((np.abs(joints - start) / limits).max()) / 0.5
    count = max(1, math.ceil(seconds / STEP_S))
    for i in range(1, count + 1):
        trial.command(start + (joints - start) * (i / count), 0.0)
    trial.settle(0.0)
