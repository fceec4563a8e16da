"""What attacks with a leaning hand share: how to come near, grasp and let go."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import drawn_back, faces, leaning, moved
from lemma.core.poses import FloatArray, Pose2
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of

LIFT_M = 0.12
_CLOSE_S = 0.6
_HOME_M = 0.02
_TOUCH_DOWN_M = 0.003
_MISSED_M = 0.02
_STAND_BY_M = 0.38
_TURNS_RAD = (0.0, 0.35, -0.35, 0.8, -0.8)


@dataclass(frozen=True)
class Hold:
    """How the hand holds a cube."""

    hand: FloatArray
    """Where it closes, (4, 4)."""
    lean: float
    """From the vertical [rad]."""
    ahead_m: float
    """How far the cube's middle is ahead of the tool centre point."""


def holds(
    trial: ControlTrial, name: str, lean: float, ahead_m: float
) -> Iterator[Hold]:
    """Yield ways to hold a cube where it lies, with a hand that leans."""
    cube, z = trial.pose(name), trial.height(name)
    for way in faces(cube.yaw, trial.outward(cube)):
        hand = drawn_back(leaning(cube.x, cube.y, z, way, lean), ahead_m)
        if trial.can(hand, drawn_back(hand, 0.08), moved(hand, dz=LIFT_M)):
            yield Hold(hand, lean, ahead_m)


def places(
    trial: ControlTrial, bottom: str, z: float, lean: float, ahead_m: float
) -> Iterator[FloatArray]:
    """Yield poses of the hand that put the middle of what it holds upon something.

    The farther ones come first: nearer the middle of what carries it.

    Args:
        trial: The attempt.
        bottom: What it shall lie on.
        z: Height of the middle of what is held [m].
        lean: Of the hand, from the vertical [rad].
        ahead_m: How far the middle of what is held is ahead of the hand.
    """
    target, support_m = trial.pose(bottom), kind_of(bottom).support_m or 0.0
    outward = trial.outward(target)
    for part in (0.0, 0.3, 0.6, 0.85, 0.97):
        x = target.x - part * support_m * math.cos(outward)
        y = target.y - part * support_m * math.sin(outward)
        for turn in _TURNS_RAD:
            hand = drawn_back(leaning(x, y, z, outward + turn, lean), ahead_m)
            if trial.can(hand, drawn_back(hand, 0.05)):
                yield hand


def resting_height(trial: ControlTrial, top: str, bottom: str) -> float:
    """Return how high the middle of a top is when it lies on its bottom [m]."""
    return trial.height(bottom) + kind_of(bottom).top_m + kind_of(top).origin_m


def stand_by(trial: ControlTrial, hand: FloatArray) -> FloatArray:
    """Return a pose of the hand high above the table, on the way to another."""
    base = trial.placement.base
    way = math.atan2(hand[1, 3] - base.y, hand[0, 3] - base.x)
    r = 0.6 * trial.reach.travel_m
    lean = 0.5 * math.acos(float(np.clip(-hand[2, 2], -1.0, 1.0)))
    x, y = base.x + r * math.cos(way), base.y + r * math.sin(way)
    ahead = math.hypot(hand[0, 2], hand[1, 2])
    heading = (
        math.atan2(hand[1, 2], hand[0, 2])
        if ahead > 0.05
        else math.atan2(hand[1, 0], hand[0, 0])
    )
    return leaning(x, y, _STAND_BY_M, heading, lean)


def approach(
    trial: ControlTrial,
    hand: FloatArray,
    opening_m: float,
    back_m: float = 0.10,
    lift_m: float = 0.0,
) -> bool:
    """Go to a pose along the fingers' direction; return whether there is a way."""
    if not trial.go(stand_by(trial, hand), opening_m):
        return False
    before = drawn_back(hand, back_m)
    above = moved(before, dz=lift_m)
    if lift_m and trial.can(above):
        trial.go(above, opening_m)
    return trial.go(before, opening_m) and trial.lead([hand], opening_m, 0.12)


def pick_up(trial: ControlTrial, hand: FloatArray, width_m: float = 0.0) -> bool:
    """Grasp what is there and lift it; return whether there is a way."""
    if not approach(trial, hand, FINGER_OPENING_M):
        return False
    trial.wait(_CLOSE_S, width_m)
    trial.lead([moved(hand, dz=LIFT_M)], width_m, 0.3)
    return True


def let_go(trial: ControlTrial, hand: FloatArray) -> None:
    """Open the fingers, draw back and get out of the way."""
    trial.wait(_CLOSE_S, FINGER_OPENING_M)
    trial.lead([drawn_back(hand, 0.10)], FINGER_OPENING_M, 0.2)
    trial.go(stand_by(trial, hand), FINGER_OPENING_M)


def is_home(trial: ControlTrial, name: str) -> bool:
    """Whether a hand that points down picks a cube up where it lies."""
    return trial.radius(trial.pose(name)) < trial.reach.travel_m - _HOME_M


def set_down(
    trial: ControlTrial, name: str, spot: Pose2, bottom_m: float = 0.0
) -> bool:
    """Set a cube down at a spot, its faces along it; False if that cannot be done."""
    hold = next(holds(trial, name, 0.0, 0.0), None)
    z = bottom_m + CUBE_EDGE_M / 2 + _TOUCH_DOWN_M
    put = leaning(spot.x, spot.y, z, spot.yaw, 0.0)
    if hold is None or not trial.can(put) or not pick_up(trial, hold.hand):
        return False
    if not approach(trial, put, 0.0):
        return False
    let_go(trial, put)
    return trial.pose(name).distance(spot) < _MISSED_M


def base_to(trial: ControlTrial, radius_m: float, bearing: float) -> Pose2:
    """Return a position by distance and direction from the robot's base."""
    base = trial.placement.base
    return Pose2(
        base.x + radius_m * math.cos(bearing),
        base.y + radius_m * math.sin(bearing),
        bearing,
    )


def farthest(
    trial: ControlTrial, ways: Iterable[Iterable[FloatArray]]
) -> list[FloatArray]:
    """Return the longest beginning that the hand can follow of some ways.

    Args:
        trial: The attempt.
        ways: Poses of the hand, one after the other; at least one way.
    """
    return max((list(takewhile(trial.can, way)) for way in ways), key=len)
