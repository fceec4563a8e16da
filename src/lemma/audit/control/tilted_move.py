"""Pick and place with a hand that leans outwards: it reaches farther."""

import math

import numpy as np

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import LEANS_RAD, drawn_back, faces, leaning, moved
from lemma.core.poses import FloatArray, Pose2
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_LIFT_M = 0.12
_OFF_M = (0.0, 0.015, 0.03, 0.045, 0.06)
"""How far before the middle of a pad a cube may be set down."""
_ABOVE_M = 0.004


def tilted_move(trial: ControlTrial) -> None:
    """Play an attempt."""
    for on in trial.goal.conjuncts:
        if not _move_on(trial, on):
            return


def _move_on(trial: ControlTrial, on: On) -> bool:
    """Put a top on its bottom, wherever the two are; return whether that went."""
    plan = plan_move(trial, on)
    if plan is None:
        raise GiveUp
    pick, place = plan
    if not approach(trial, pick, 0.10, FINGER_OPENING_M):
        return False
    trial.wait(0.6, 0.0)
    trial.lead([moved(pick, dz=_LIFT_M)], 0.0, 0.3)
    if not approach(trial, place, 0.06, 0.0, lift_m=0.06):
        return False
    trial.wait(0.6, FINGER_OPENING_M)
    trial.lead([drawn_back(place, 0.10)], FINGER_OPENING_M, 0.2)
    trial.go(stand_by(trial, place), FINGER_OPENING_M)
    return True


def plan_move(trial: ControlTrial, on: On) -> tuple[FloatArray, FloatArray] | None:
    """Return how the hand picks and places, leaning the same; None if it cannot.

    What is held leans with the hand, so it is set down as it was picked up.
    """
    top, kind = trial.pose(on.top), kind_of(on.bottom)
    bottom = trial.pose(on.bottom)
    grip_m = trial.height(on.top)
    rest_m = trial.height(on.bottom) + kind.top_m + kind_of(on.top).origin_m
    offs = _OFF_M if kind.fixed else _OFF_M[:2]
    count = 0
    for lean in LEANS_RAD:
        for way in faces(top.yaw, trial.outward(top)):
            pick = leaning(top.x, top.y, grip_m, way, lean)
            if not trial.can(pick, drawn_back(pick, 0.08), moved(pick, dz=_LIFT_M)):
                continue
            place = _place(trial, bottom, rest_m + _ABOVE_M, lean, offs)
            if place is not None:
                if count == trial.attempt:
                    return pick, place
                count += 1
                break
    return None


def _place(
    trial: ControlTrial, bottom: Pose2, z: float, lean: float, offs: tuple[float, ...]
) -> FloatArray | None:
    outward = trial.outward(bottom)
    for off in offs:
        x = bottom.x - off * math.cos(outward)
        y = bottom.y - off * math.sin(outward)
        for turn in (0.0, 0.35, -0.35, 0.8, -0.8):
            place = leaning(x, y, z, outward + turn, lean)
            if trial.can(place, drawn_back(place, 0.05)):
                return place
    return None


def stand_by(trial: ControlTrial, hand: FloatArray) -> FloatArray:
    """Return a pose of the hand high above the table, on the way to another."""
    base = trial.placement.base
    way = math.atan2(hand[1, 3] - base.y, hand[0, 3] - base.x)
    r = 0.6 * trial.reach.travel_m
    lean = 0.5 * math.acos(float(np.clip(-hand[2, 2], -1.0, 1.0)))
    x, y = base.x + r * math.cos(way), base.y + r * math.sin(way)
    return leaning(x, y, 0.38, math.atan2(hand[1, 0], hand[0, 0]), lean)


def approach(
    trial: ControlTrial,
    hand: FloatArray,
    back_m: float,
    opening_m: float,
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


ATTACKS.add(
    "tilted_move",
    Attack(
        name="tilted_move",
        summary="Picks and places with a hand that leans outwards.",
        level="control",
        play=tilted_move,
        attempts=4,
        cheap=True,
    ),
)
