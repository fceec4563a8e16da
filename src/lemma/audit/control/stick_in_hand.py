"""What attacks share that hold the stick at control level: to grasp, to drag."""

import math

from lemma.audit.attack import GiveUp
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import LEANS_RAD, leaning, moved
from lemma.audit.handling import approach, let_go
from lemma.audit.pushes import END_GRASP, GRASPS, HOOK, Push, push
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.stick import STICK_GRASP_HEIGHT_M

HOVER_M = 0.022
"""Height of the hand while the stick is moved just above the table."""
_LENGTHS_M = tuple(round(0.08 + 0.04 * i, 2) for i in range(16))
_HEADINGS = 24
_HOME_M = 0.05
_CLOSE_S = 0.6


def require_stick(trial: ControlTrial) -> None:
    """Give up where there is no stick, or no part of it could be touched."""
    if STICK not in trial.scene.movable_names:
        raise GiveUp
    stick = trial.pose(STICK)
    if all(trial.radius(stick @ grasp) > trial.could.touch_m for grasp in GRASPS):
        raise GiveUp


def hand_at(grip: Pose2, z: float, lean: float = 0.0) -> FloatArray:
    """Return the hand that holds the stick at a pose of the gripper.

    It leans along the stick, so that the stick stays level.
    """
    return leaning(grip.x, grip.y, z, grip.yaw, lean)


def either_way(trial: ControlTrial, grip: Pose2) -> Pose2:
    """Return a grip, or half a turn from it: whichever points outwards."""
    if abs(wrap(grip.yaw - trial.outward(grip))) <= 0.5 * math.pi:
        return grip
    return Pose2(grip.x, grip.y, wrap(grip.yaw + math.pi))


def grasp_stick(trial: ControlTrial, grasp: Pose2, lean: float = 0.0) -> bool:
    """Close the fingers around the stick where it lies; False if they cannot."""
    grip = either_way(trial, trial.pose(STICK) @ grasp)
    hand = hand_at(grip, STICK_GRASP_HEIGHT_M, lean)
    if not trial.can(hand) or not approach(trial, hand, FINGER_OPENING_M):
        return False
    trial.wait(_CLOSE_S, 0.0)
    return True


def lay_stick(trial: ControlTrial, grasp: Pose2, stick: Pose2) -> bool:
    """Carry the stick, which is held, to a pose and let it go; False if it cannot."""
    hand = hand_at(either_way(trial, stick @ grasp), STICK_GRASP_HEIGHT_M + 0.002)
    up = moved(trial.hand(), dz=0.12)
    if not trial.lead([up], 0.0, 0.25):
        return False
    if not trial.go(moved(hand, dz=0.12), 0.0, 0.5) or not trial.lead([hand], 0.0, 0.1):
        return False
    let_go(trial, hand)
    return True


def hook_home(trial: ControlTrial, name: str, lean: float = 0.0) -> bool:
    """Drag something into reach, with a hand that may lean; False if it cannot."""
    way = _best_hook(trial, name, lean)
    if way is None or not grasp_stick(trial, END_GRASP, lean):
        return False
    start = hand_at(either_way(trial, way.start), HOVER_M, lean)
    end = hand_at(either_way(trial, way.end), HOVER_M, lean)
    high = moved(start, dz=0.12)
    if not trial.lead([moved(trial.hand(), dz=0.12)], 0.0, 0.25):
        return False
    if not trial.go(high, 0.0, 0.5) or not trial.lead([start, end], 0.0, 0.12):
        return False
    # Off the cube, so that fingers fit around it.
    away = math.cos(way.stick.yaw) * 0.04, math.sin(way.stick.yaw) * 0.04
    trial.lead([moved(end, *away)], 0.0, 0.1)
    trial.lead([moved(trial.hand(), dz=0.09)], 0.0, 0.2)
    return True


def _best_hook(trial: ControlTrial, name: str, lean: float) -> Push | None:
    """Return the shortest hooking that brings something home, if there is one."""
    thing, base = trial.pose(name), trial.placement.base
    inner, outer = trial.reach.inner_m + _HOME_M, trial.reach.travel_m - _HOME_M
    for length_m in _LENGTHS_M:
        for turn in range(_HEADINGS):
            heading = math.tau * turn / _HEADINGS
            way = push(HOOK, END_GRASP, thing, heading, length_m)
            if not inner < base.distance(way.moved) < outer:
                continue
            hands = [
                hand_at(either_way(trial, grip), HOVER_M, lean)
                for grip in (way.start, way.end)
            ]
            if trial.can(*hands):
                return way
    return None


def leans_for_stick(trial: ControlTrial) -> tuple[float, ...]:
    """Return how the hand may lean when it takes the stick by its end."""
    grip = either_way(trial, trial.pose(STICK) @ END_GRASP)
    return tuple(
        lean
        for lean in LEANS_RAD
        if trial.can(hand_at(grip, STICK_GRASP_HEIGHT_M, lean))
    )
