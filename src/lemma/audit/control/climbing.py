"""Push a thing against a pad with the stick; then, with the stick raised, over it."""

import math
from dataclasses import dataclass

from lemma.audit.attack import Lost
from lemma.audit.control.stick_in_hand import HOVER_M, grasp_stick, hand_at
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import moved
from lemma.audit.pushes import CONTACTS, push
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.tasks.goal import On

_PUSH_M_S = 0.10
_BACK_M = 0.02
_AWAY_M = 0.15
_OVERS_M = (0.0, 0.02, -0.02, 0.04)


@dataclass(frozen=True)
class Climb:
    """The way of the hand that holds the stick."""

    start: FloatArray
    """Behind what is pushed."""
    end: FloatArray
    """Where that touches the pad."""
    ahead: tuple[float, float]
    """The direction of the push."""
    gap_m: float
    """From there to the pad's middle."""


def climb(
    trial: ControlTrial,
    on: On,
    lowest: str,
    hand_m: float,
    raises_m: tuple[float, ...],
) -> None:
    """Push what lies on the table against a pad, raise the stick, and push again.

    Args:
        trial: The attempt.
        on: What shall hold.
        lowest: What is pushed along the table.
        hand_m: Where along the handle the stick is held [m].
        raises_m: By how much the stick is raised for the second push [m].
    """
    way = push_against(trial, on, lowest, hand_m)
    if way is None:
        return
    ready = trial.snapshot()
    for raise_m in raises_m:
        for over_m in _OVERS_M:
            trial.restore(ready)
            try:
                _raise_and_push(trial, way, raise_m, over_m)
            except Lost:
                continue


def push_against(
    trial: ControlTrial, on: On, lowest: str, hand_m: float, short_m: float = 0.0
) -> Climb | None:
    """Push a thing against a pad, or short of it; None if that does not go."""
    grasp = Pose2(hand_m, 0.0)
    if not grasp_stick(trial, grasp):
        return None
    way = _find(trial, on, lowest, grasp)
    if way is None or not trial.lead([moved(trial.hand(), dz=0.14)], 0.0, 0.25):
        return None
    if not trial.go(moved(way.start, dz=0.12), 0.0, 0.4):
        return None
    end = ahead_of(way.end, way, -short_m)
    return way if trial.lead([way.start, end], 0.0, _PUSH_M_S) else None


def _raise_and_push(
    trial: ControlTrial, way: Climb, raise_m: float, over_m: float
) -> None:
    back = ahead_of(way.end, way, -_BACK_M)
    raised = moved(back, dz=raise_m)
    pushed = ahead_of(raised, way, _BACK_M + way.gap_m + over_m)
    away = ahead_of(raised, way, -_AWAY_M)
    if trial.lead([back, raised, pushed, away], 0.0, _PUSH_M_S):
        # What is held at the end, the stick too, is no success.
        trial.wait(2.2, FINGER_OPENING_M)


def ahead_of(hand: FloatArray, way: Climb, distance_m: float) -> FloatArray:
    """Return a hand farther along the push [m]."""
    return moved(hand, distance_m * way.ahead[0], distance_m * way.ahead[1])


def _find(trial: ControlTrial, on: On, lowest: str, grasp: Pose2) -> Climb | None:
    """Return a way that the hand can follow, with any side of the stick."""
    pad, thing = trial.pose(on.bottom), trial.pose(lowest)
    heading = math.atan2(pad.y - thing.y, pad.x - thing.x)
    gap_m = kind_of(on.bottom).disc_m + CUBE_EDGE_M / 2
    length_m = thing.distance(pad) - gap_m + 0.002
    # Which way round the hand holds the stick stays.
    hand = trial.hand()
    held = wrap(math.atan2(hand[1, 0], hand[0, 0]) - trial.pose(STICK).yaw)
    turn = Pose2(0.0, 0.0, math.pi if abs(held) > 0.5 * math.pi else 0.0)
    for contact in CONTACTS:
        way = push(contact, grasp, thing, heading, length_m)
        start, end = (hand_at(grip @ turn, HOVER_M) for grip in (way.start, way.end))
        found = Climb(start, end, (math.cos(heading), math.sin(heading)), gap_m)
        far = moved(ahead_of(end, found, gap_m - 0.03), dz=0.05)
        if trial.can(start, end, far, moved(start, dz=0.12)):
            return found
    return None
