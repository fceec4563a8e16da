"""Attacks with the stick in a hand that may lean: dragging, pushing, carrying on it.

They bring a cube over the edge of its pad, or carry it farther than the hand reaches.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from lemma.audit.attack import attack
from lemma.audit.control_trial import STEP_S, ControlTrial, ahead, leaning, moved
from lemma.audit.pushes import CONTACTS, END_GRASP, GRASPS, HOOK, LONGEST_M, Push, push
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    STICK_GRASP_HEIGHT_M,
    STICK_SECTION_M,
)
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
    """Return the hand's rotation in the stick's frame: none or half a turn."""
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
    """Lift the held stick, and bring it above a pose; False if the arm cannot.

    Args:
        trial: The attempt.
        hand: Pose of the hand, (4, 4).
        lift_m: Height of the lift [m].
        over_m: Height above the pose [m].
        speed: Share of the joints' velocity limits.
    """
    up, over = moved(trial.hand(), dz=lift_m), moved(hand, dz=over_m)
    return trial.lead([up], 0.0, 0.25) and trial.go(over, 0.0, speed)


def lay_stick(trial: ControlTrial, grasp: Pose2, stick: Pose2) -> bool:
    """Carry the held stick to a pose and release it; False if the arm cannot."""
    hand = leaning(either_way(trial, stick @ grasp), LOW_M)
    if not carry_over(trial, hand) or not trial.lead([hand], 0.0, 0.1):
        return False
    trial.let_go(hand)
    return True


def hook_home(trial: ControlTrial, name: str, lean: float = 0.0) -> bool:
    """Drag an object into reach, with a hand that may lean; False if that fails."""
    way = _shortest_hook(trial, name, lean)
    if way is None or not grasp_stick(trial, END_GRASP, lean):
        return False
    start, end = _hands(trial, way, lean)
    if not carry_over(trial, start) or not trial.lead([start, end], 0.0, 0.12):
        return False
    # Move off the cube, so that fingers fit around it.
    trial.lead([ahead(end, 0.04, way.stick.yaw)], 0.0, 0.1)
    trial.lead([moved(trial.hand(), dz=0.09)], 0.0, 0.2)
    return True


def fetch(trial: ControlTrial, name: str, lean: float = 0.0) -> bool:
    """Hook a cube into reach unless it is there; False if it cannot be hooked."""
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
    """The path of a hand that pushes an object against a pad with the stick."""

    start: FloatArray
    """Hand behind the object, (4, 4)."""
    end: FloatArray
    """Hand when the object touches the pad, (4, 4)."""
    heading: float
    """Direction of the push [rad]."""
    gap_m: float
    """Distance of the object's middle from the pad's then [m]."""

    def beyond(self, distance_m: float) -> FloatArray:
        """Return the hand at a distance beyond the end."""
        return ahead(self.end, distance_m, self.heading)


def push_against(
    trial: ControlTrial, on: On, thing: str, hand_m: float, short_m: float = 0.0
) -> Climb | None:
    """Push an object against a pad, or short of it; None if that fails.

    Args:
        trial: The attempt.
        on: Its bottom is the pad.
        thing: Name of the object that is pushed along the table.
        hand_m: Position of the grasp along the handle [m].
        short_m: Distance from the pad at which the push ends [m].
    """
    grasp = Pose2(hand_m, 0.0)
    way = _climb(trial, on, thing, grasp) if grasp_stick(trial, grasp) else None
    if way is None or not carry_over(trial, way.start, lift_m=0.14, speed=0.4):
        return None
    there = trial.lead([way.start, way.beyond(-short_m)], 0.0, _PUSH_M_S)
    return way if there else None


def _climb(trial: ControlTrial, on: On, name: str, grasp: Pose2) -> Climb | None:
    """Return a path that the hand can follow, with any side of the stick."""
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


_LONGEST_M = HANDLE_LENGTH_M + 2.0 * CUBE_EDGE_M
_BACK_M = 0.02
_AWAY_M = 0.15
_OVERS_M = (0.0, 0.02, -0.02, 0.04)
# Position of the grasp along the handle, by attempt.
_TOPPLE_HANDS_M = (0.45, 0.25, 0.06)
# Above the middle of the cube, and still below its top.
_TOPPLE_RAISES_M = (0.03, 0.036, 0.042, 0.048)
_TOWER_HANDS_M = (0.45, 0.30, 0.15)
# Position of the grasp along the handle, and distance from the cube to the pad before
# the stroke; by attempt [m].
_SHOTS = ((0.45, 0.03), (0.25, 0.08), (0.25, 0.2))
_SWING_M = 0.12
_STROKE_RAISES_M = (0.0, 0.015, 0.03)
_SPEEDS_M_S = (0.8, 1.4, 2.2)
_ROLL_S = 1.2


@attack("control", attempts=len(_TOWER_HANDS_M), candidates=len(_OVERS_M))
def tower_push(trial: ControlTrial) -> None:
    """Pushes a tower against a pad, and its upper cube over onto the pad."""
    on = trial.goal.placements[0]
    _require_pad(trial, on)
    near = [name for name in trial.spare() if trial.is_home(name)]
    trial.require(near)
    if not fetch(trial, on.top):
        return
    pad = trial.pose(on.bottom)
    spot = trial.at(trial.reach.travel_m - 0.09, trial.outward(pad))
    stands = trial.set_down(near[0], spot) and trial.set_down(on.top, spot, CUBE_EDGE_M)
    if stands and trial.height(on.top) > CUBE_EDGE_M:
        hand_m = _TOWER_HANDS_M[trial.attempt]
        _push_over(trial, on, near[0], hand_m, (CUBE_EDGE_M + 0.003,))


@attack(
    "control",
    attempts=len(_TOPPLE_HANDS_M),
    candidates=len(_TOPPLE_RAISES_M) * len(_OVERS_M),
    simulated_s=200.0,
)
def topple(trial: ControlTrial) -> None:
    """Pushes a cube against its pad with the stick, and topples it onto it."""
    for on in trial.goal.placements:
        _require_pad(trial, on)
    for on in trial.goal.placements:
        hand_m = _TOPPLE_HANDS_M[trial.attempt]
        _push_over(trial, on, on.top, hand_m, _TOPPLE_RAISES_M)


@attack(
    "control", attempts=len(_SHOTS), candidates=len(_STROKE_RAISES_M) * len(_SPEEDS_M_S)
)
def strike(trial: ControlTrial) -> None:
    """Strikes a cube with the stick, so that it jumps onto its pad."""
    on = trial.goal.placements[0]
    _require_pad(trial, on)
    trial.require(len(trial.goal.placements) == 1)
    hand_m, short_m = _SHOTS[trial.attempt]
    way = push_against(trial, on, on.top, hand_m, short_m)
    if way is None:
        return
    ready = way.beyond(-short_m)

    def blow(option: tuple[float, float]) -> None:
        raise_m, speed_m_s = option
        back = moved(ahead(ready, -_SWING_M, way.heading), dz=raise_m)
        through = moved(ahead(ready, short_m + 0.02, way.heading), dz=raise_m)
        if trial.lead([back], 0.0, 0.15):
            trial.lead([through], 0.0, speed_m_s)
            trial.wait(_ROLL_S, 0.0)
            trial.lead([back], 0.0, 0.15)
            trial.wait(_ROLL_S)

    trial.try_each(product(_STROKE_RAISES_M, _SPEEDS_M_S), blow)


def _require_pad(trial: ControlTrial, on: On) -> None:
    """Give up unless the stick could push a cube against a fixed pad."""
    require_stick(trial)
    trial.require(kind_of(on.bottom).fixed)
    trial.require_near(on.bottom, trial.could.touch_m + _LONGEST_M)


def _push_over(
    trial: ControlTrial,
    on: On,
    lowest: str,
    hand_m: float,
    raises_m: tuple[float, ...],
) -> None:
    """Push against a pad, raise the stick, and push again over it.

    Args:
        trial: The attempt.
        on: Its bottom is the pad.
        lowest: Name of the object that is pushed along the table.
        hand_m: Position of the grasp along the handle [m].
        raises_m: Heights of the stick in the second push [m].
    """
    way = push_against(trial, on, lowest, hand_m)
    if way is None:
        return

    def again(option: tuple[float, float]) -> None:
        raise_m, over_m = option
        back = way.beyond(-_BACK_M)
        raised = moved(back, dz=raise_m)
        pushed = ahead(raised, _BACK_M + way.gap_m + over_m, way.heading)
        away = ahead(raised, -_AWAY_M, way.heading)
        if trial.lead([back, raised, pushed, away], 0.0, _PUSH_M_S):
            # An object held at the end does not count, so the fingers open.
            trial.wait(2.2)

    trial.try_each(product(raises_m, _OVERS_M), again)


# Position of the cube on the stick, in the stick's frame.
_SPOT = Pose2(HANDLE_LENGTH_M - 0.004, 0.08)
# Position of the grasp along the handle then, by attempt.
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


@attack(
    "control",
    attempts=len(_HANDS_M),
    candidates=len(_AIMS_M) * (len(_PITCHES_RAD) + 1),
    simulated_s=200.0,
)
def tip_off_stick(trial: ControlTrial) -> None:
    """Carries a cube on the stick over its pad, and tips or jerks it off."""
    require_stick(trial)
    for on in trial.goal.placements:
        beyond_m = LONGEST_M + CUBE_EDGE_M + trial.support_m(on.bottom)
        trial.require_near(on.bottom, trial.could.touch_m + beyond_m)
    # The stick serves one pad only.
    on = trial.goal.placements[0]
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
    """Lift stick and cube, bring them over the pad, and try to leave the cube there."""
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
        # An object held at the end does not count, so the fingers open.
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
    # The arm's swing turns the stick; the hand adds the rest of its yaw.
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
    """Return the hand that holds the cube over its pad, or a little beyond."""
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
    """Yield motions of the hand that make the cube leave the stick."""
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
        angle: Angle by which that end goes down [rad].
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
