"""Attacks of the hand alone: it leans outwards, drops, or pulls with its fingertips."""

import math
from collections.abc import Iterator
from itertools import islice

from lemma.audit.attack import attack
from lemma.audit.control.stick import either_way, fetch, require_stick
from lemma.audit.control_trial import (
    LEANS_RAD,
    ControlTrial,
    ahead,
    drawn_back,
    leaning,
    moved,
)
from lemma.audit.pushes import END_GRASP
from lemma.core.poses import FloatArray, Pose2
from lemma.robots.gripper import FINGERTIP_BEYOND_TCP_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_GRASP_HEIGHT_M,
)
from lemma.tasks.goal import On

_ABOVE_M = 0.004
_DROP_M = (0.03, 0.08)
# Distance of a cube's middle ahead of the tool centre point; the second is the most
# that the fingertips hold.
_AHEAD_M = (0.0, 0.022)
_TURNS_RAD = (0.0, 0.35, -0.35, 0.8, -0.8)
# Shares of the way from the middle of a bottom to the edge of its support.
_SHARES = (0.0, 0.3, 0.6, 0.85, 0.97)
# Inverse kinematics is tried this far beyond the distance known to be out of reach.
_DOUBT_M = 0.03
_PRESS_M = 0.004
_STROKES = 3
_SURE_M = 0.01
_STEP_M = 0.03
_STICK_TRIES = 3


@attack("control", attempts=6, cheap=True)
def tilted_move(trial: ControlTrial) -> None:
    """Picks and places with a hand that leans outwards, or drops."""
    _require_one_hand(trial)
    for on in trial.goal.placements:
        trial.require_near(on.bottom, _place_m(trial, on) + _DOUBT_M)
    for on in trial.goal.placements:
        if not _put_on(trial, on, trial.attempt):
            return


@attack("control", attempts=3, cheap=True)
def rake(trial: ControlTrial) -> None:
    """Pulls cubes nearer with the fingertips of a leaning hand."""
    _require_one_hand(trial)
    for name in trial.goal.entities:
        # An object that cannot be touched can neither be raked nor built upon.
        disc_m, support_m = kind_of(name).disc_m, trial.support_m(name)
        trial.require_near(name, trial.could.radius_m(disc_m, support_m))
    cubes = [name for name in trial.goal.entities if kind_of(name).cargo]
    for name in [cube for cube in cubes if not trial.is_home(cube, _SURE_M)]:
        for _ in range(_STROKES):
            if trial.is_home(name, _SURE_M) or not _stroke(trial, name):
                break
    for on in trial.goal.placements:
        _put_on(trial, on)


@attack("control", attempts=_STICK_TRIES)
def tilted_stick(trial: ControlTrial) -> None:
    """Hooks with a leaning hand that holds the stick, then builds alone."""
    require_stick(trial)
    for on in trial.goal.placements:
        for name in (on.top, on.bottom):
            stick_m = HANDLE_LENGTH_M + HOOK_LENGTH_M if kind_of(name).cargo else 0.0
            trial.require_near(name, _place_m(trial, on) + stick_m)
    grip = either_way(trial, trial.pose(STICK) @ END_GRASP)
    hands = ((leaning(grip, STICK_GRASP_HEIGHT_M, lean), lean) for lean in LEANS_RAD)
    leans = [lean for hand, lean in hands if trial.can(hand)]
    trial.require(trial.attempt < len(leans))
    lean = leans[-1 - trial.attempt * (len(leans) // _STICK_TRIES)]
    for name in trial.goal.entities:
        if kind_of(name).cargo:
            fetch(trial, name, lean)
    for on in trial.goal.placements:
        _put_on(trial, on)


def _require_one_hand(trial: ControlTrial) -> None:
    """Give up where one hand cannot hold a thing; see :mod:`.control.handle`."""
    trial.require(all(kind_of(on.top).carried is None for on in trial.goal.placements))


def _place_m(trial: ControlTrial, on: On) -> float:
    """Return the largest distance of a bottom at which a top can be put on it [m]."""
    return trial.could.place_m + trial.support_m(on.bottom)


def _put_on(trial: ControlTrial, on: On, number: int = 0) -> bool:
    """Put a top on its bottom; return whether the hand could do so.

    Args:
        trial: The attempt.
        on: The condition to reach: a top on its bottom.
        number: Index of the grasp and placement, among those that geometry allows.

    Raises:
        GiveUp: Geometry allows fewer.
    """
    way = next(islice(_ways(trial, on), number, None), None)
    trial.require(way is not None)
    assert way is not None
    hold, place = way
    return trial.pick_up(hold) and trial.put(place, 0.06, lift_m=0.06)


def _ways(trial: ControlTrial, on: On) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield pairs of hands: one that grasps a cube, one that sets it down or drops it.

    A held cube leans with the hand. It stands upright again if the hand has the same
    lean at the end, or a quarter turn more; a dropped cube may stand upright.
    """
    rest_m = trial.resting_height(on)
    flush = [(0.0, _ABOVE_M), (math.pi / 2, _ABOVE_M)]
    drops = [(more, high) for high in _DROP_M for more in (0.6, 0.9, 1.2)]
    for more, high in (*flush, *drops):
        for ahead_m in _AHEAD_M:
            # Take the smallest lean that works.
            for lean in LEANS_RAD:
                places = _places(trial, on, rest_m + high, lean + more, ahead_m)
                place = next(places, None)
                if place is None:
                    continue
                hold = next(trial.holds(on.top, lean, ahead_m), None)
                if hold is not None:
                    yield hold, place
                    break


def _places(
    trial: ControlTrial, on: On, z: float, lean: float, ahead_m: float
) -> Iterator[FloatArray]:
    """Yield hands that put the middle of a held cube upon its bottom."""
    target, support_m = trial.pose(on.bottom), trial.support_m(on.bottom)
    outward = trial.outward(target)
    for share in _SHARES:
        x = target.x - share * support_m * math.cos(outward)
        y = target.y - share * support_m * math.sin(outward)
        for turn in _TURNS_RAD:
            spot = Pose2(x, y, outward + turn)
            hand = drawn_back(leaning(spot, z, lean), ahead_m)
            if trial.can(hand, drawn_back(hand, 0.05)):
                yield hand


def _stroke(trial: ControlTrial, name: str) -> bool:
    """Pull a cube once, as far as the hand keeps its lean; False if it cannot."""
    start = _first_touch(trial, name)
    if start is None:
        return False
    above = moved(drawn_back(start, 0.06), dz=0.06)
    if not trial.can(above):
        above = drawn_back(start, 0.06)
    if not (trial.stand_by(start, 0.0) and trial.go(above, 0.0)):
        return False
    if not trial.lead([start], 0.0, 0.12):
        return False
    inward = trial.outward(trial.pose(name)) + math.pi
    beyond_m = trial.radius(trial.pose(name)) - trial.reach.travel_m
    count = max(2, math.ceil((beyond_m + 0.08) / _STEP_M))
    steps = [ahead(start, i * _STEP_M, inward) for i in range(1, count + 1)]
    trial.lead(steps, 0.0, 0.08)
    up = moved(trial.hand(), dz=0.10)
    if trial.can(up):
        trial.lead([up], 0.0, 0.2)
    return True


def _first_touch(trial: ControlTrial, name: str) -> FloatArray | None:
    """Return the hand whose fingertips begin to pull, with the least lean.

    By attempt they pull from above, behind the far face, or on the near edge.
    """
    cube, top = trial.pose(name), trial.height(name) + CUBE_EDGE_M / 2
    ahead_m, z = (
        (0.005, top - _PRESS_M),
        (CUBE_EDGE_M / 2 + 0.012, top - 0.03),
        (-0.015, top - _PRESS_M),
    )[trial.attempt]
    outward = trial.outward(cube)
    x = cube.x + ahead_m * math.cos(outward)
    spot = Pose2(x, cube.y + ahead_m * math.sin(outward), outward)
    for lean in LEANS_RAD:
        hand = drawn_back(leaning(spot, z, lean), FINGERTIP_BEYOND_TCP_M)
        if trial.can(hand, drawn_back(hand, 0.06)):
            return hand
    return None
