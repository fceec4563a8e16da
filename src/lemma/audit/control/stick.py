"""The stick in a hand that may lean: take it, lay it down, drag and push with it."""

import math
from dataclasses import dataclass

from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import ahead, leaning, moved
from lemma.audit.pushes import CONTACTS, END_GRASP, GRASPS, HOOK, Push, push
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import STICK_GRASP_HEIGHT_M
from lemma.tasks.goal import On

HOVER_M = 0.022
"""Height of the hand while the stick is moved just above the table."""
LOW_M = STICK_GRASP_HEIGHT_M + 0.002
_LENGTHS_M = tuple(round(0.08 + 0.04 * i, 2) for i in range(16))
_HEADINGS = 24
_HOME_M = 0.05
_CLOSE_S = 0.6
_PUSH_M_S = 0.10


def require_stick(trial: ControlTrial) -> None:
    """Give up where there is no stick, or no part of it could be touched."""
    trial.require(STICK in trial.scene.movable_names)
    grips = [trial.pose(STICK) @ grasp for grasp in GRASPS]
    trial.require(min(map(trial.radius, grips)) <= trial.could.touch_m)


def either_way(trial: ControlTrial, grip: Pose2) -> Pose2:
    """Return a grip, or half a turn from it: whichever points outwards."""
    if abs(wrap(grip.yaw - trial.outward(grip))) <= 0.5 * math.pi:
        return grip
    return Pose2(grip.x, grip.y, wrap(grip.yaw + math.pi))


def held_turn(trial: ControlTrial) -> Pose2:
    """Return the rotation of the hand in the stick's frame, by none or half a turn."""
    hand = trial.hand()
    held = wrap(math.atan2(hand[1, 0], hand[0, 0]) - trial.pose(STICK).yaw)
    return Pose2(0.0, 0.0, math.pi if abs(held) > 0.5 * math.pi else 0.0)


def grasp_stick(trial: ControlTrial, grasp: Pose2, lean: float = 0.0) -> bool:
    """Close the fingers around the stick where it lies; False if they cannot.

    Args:
        trial: The attempt.
        grasp: Gripper in the stick's frame.
        lean: Lean of the hand along the stick, which stays level [rad].
    """
    grip = either_way(trial, trial.pose(STICK) @ grasp)
    hand = leaning(grip, STICK_GRASP_HEIGHT_M, lean)
    if not trial.can(hand) or not trial.approach(hand, FINGER_OPENING_M):
        return False
    trial.wait(_CLOSE_S, 0.0)
    return True


def carry_over(
    trial: ControlTrial,
    hand: FloatArray,
    lift_m: float = 0.12,
    over_m: float = 0.12,
    speed: float = 0.5,
) -> bool:
    """Lift the held stick, and bring it above a pose; False if it cannot be."""
    up, over = moved(trial.hand(), dz=lift_m), moved(hand, dz=over_m)
    return trial.lead([up], 0.0, 0.25) and trial.go(over, 0.0, speed)


def lay_stick(trial: ControlTrial, grasp: Pose2, stick: Pose2) -> bool:
    """Carry the held stick to a pose and let it go; False if it cannot be."""
    hand = leaning(either_way(trial, stick @ grasp), LOW_M)
    if not carry_over(trial, hand) or not trial.lead([hand], 0.0, 0.1):
        return False
    trial.let_go(hand)
    return True


def hook_home(trial: ControlTrial, name: str, lean: float = 0.0) -> bool:
    """Drag something into reach, with a hand that may lean; False if it cannot be."""
    way = _shortest_hook(trial, name, lean)
    if way is None or not grasp_stick(trial, END_GRASP, lean):
        return False
    start, end = _hands(trial, way, lean)
    if not carry_over(trial, start) or not trial.lead([start, end], 0.0, 0.12):
        return False
    # Off the cube, so that fingers fit around it.
    trial.lead([ahead(end, 0.04, way.stick.yaw)], 0.0, 0.1)
    trial.lead([moved(trial.hand(), dz=0.09)], 0.0, 0.2)
    return True


def fetch(trial: ControlTrial, name: str, lean: float = 0.0) -> bool:
    """Hook a cube home unless it is there; False if it cannot be hooked."""
    return trial.is_home(name) or hook_home(trial, name, lean)


def _hands(trial: ControlTrial, way: Push, lean: float) -> list[FloatArray]:
    grips = (either_way(trial, grip) for grip in (way.start, way.end))
    return [leaning(grip, HOVER_M, lean) for grip in grips]


def _shortest_hook(trial: ControlTrial, name: str, lean: float) -> Push | None:
    thing = trial.pose(name)
    inner, outer = trial.reach.inner_m + _HOME_M, trial.reach.travel_m - _HOME_M
    for length_m in _LENGTHS_M:
        for turn in range(_HEADINGS):
            heading = math.tau * turn / _HEADINGS
            way = push(HOOK, END_GRASP, thing, heading, length_m)
            at_home = inner < trial.radius(way.moved) < outer
            if at_home and trial.can(*_hands(trial, way, lean)):
                return way
    return None


@dataclass(frozen=True)
class Climb:
    """The way of the hand that pushes something against a pad with the stick."""

    start: FloatArray
    """Behind what is pushed."""
    end: FloatArray
    """Where that touches the pad."""
    heading: float
    """Direction of the push [rad]."""
    gap_m: float
    """From there to the pad's middle."""

    def beyond(self, distance_m: float) -> FloatArray:
        """Return the hand at a distance beyond the end."""
        return ahead(self.end, distance_m, self.heading)


def push_against(
    trial: ControlTrial, on: On, thing: str, hand_m: float, short_m: float = 0.0
) -> Climb | None:
    """Push a thing against a pad, or short of it; None if that cannot be done.

    Args:
        trial: The attempt.
        on: Its bottom is the pad.
        thing: Name of the object that is pushed along the table.
        hand_m: Where along the handle the stick is held [m].
        short_m: Distance from the pad at which the push ends [m].
    """
    grasp = Pose2(hand_m, 0.0)
    way = _climb(trial, on, thing, grasp) if grasp_stick(trial, grasp) else None
    if way is None or not carry_over(trial, way.start, lift_m=0.14, speed=0.4):
        return None
    there = trial.lead([way.start, way.beyond(-short_m)], 0.0, _PUSH_M_S)
    return way if there else None


def _climb(trial: ControlTrial, on: On, name: str, grasp: Pose2) -> Climb | None:
    """Return a way that the hand can follow, with any side of the stick."""
    pad, thing = trial.pose(on.bottom), trial.pose(name)
    heading = math.atan2(pad.y - thing.y, pad.x - thing.x)
    gap_m = kind_of(on.bottom).disc_m + CUBE_EDGE_M / 2
    length_m = thing.distance(pad) - gap_m + 0.002
    turn = held_turn(trial)
    for contact in CONTACTS:
        way = push(contact, grasp, thing, heading, length_m)
        start, end = (leaning(grip @ turn, HOVER_M) for grip in (way.start, way.end))
        found = Climb(start, end, heading, gap_m)
        far = moved(found.beyond(gap_m - 0.03), dz=0.05)
        if trial.can(start, end, far, moved(start, dz=0.12)):
            return found
    return None
