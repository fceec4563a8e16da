"""Attacks that push cubes along the table with the hand, or with cubes in between."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import LEANS_RAD, leaning, moved
from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

# Between two cubes of a row when they are set down.
_GAP_M = 0.004
# Half of two closed fingers.
_FINGERS_M = 0.015
_STEP_M = 0.02
_HIGH_M = 0.20
_SPOTS = 12
# How many spare cubes are in the row, all if None, and how far the upper cube of a
# tower stands out, None without one [m]; by attempt.
_WAYS: tuple[tuple[int | None, float | None], ...] = (
    (None, None),
    (None, 0.013),
    (None, 0.018),
    (None, 0.023),
    (1, None),
    (1, 0.018),
    (1, 0.023),
)
# Speeds of the push; a row that is fast slides on.
_SPEEDS_M_S = (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.65, 0.8)
_BEHIND_M = CUBE_EDGE_M / 2 + 0.035
_LOW_M = 0.02
_SLIDE_M = 0.10
_RAISE_M = 0.08
_REST_S = 1.5
_SLACK_M = 0.015


@dataclass(frozen=True)
class Line:
    """A line along which things are pushed; it ends in the middle of a pad."""

    end: Pose2
    """The pad, and the direction of the push as the yaw."""

    def at(self, before_m: float) -> Pose2:
        """Return the position at a distance before the end."""
        return self.end @ Pose2(-before_m, 0.0)

    def before_m(self, pose: Pose2) -> float:
        """Return the distance of a position before the end [m]."""
        return -(self.end.inverse() @ pose).x


def row_m(count: int) -> float:
    """Return the length of a row of cubes [m]."""
    return count * (CUBE_EDGE_M + _GAP_M)


def line_to(trial: ControlTrial, on: On, beside_m: float = 0.0) -> Line:
    """Return the line to a pad that passes the robot's base on its left [m]."""
    pad = trial.pose(on.bottom)
    turn = math.asin(beside_m / trial.radius(pad))
    return Line(Pose2(pad.x, pad.y, trial.outward(pad) - turn))


def build_row(
    trial: ControlTrial, on: On, spare: Sequence[str], line: Line, out_m: float | None
) -> list[str]:
    """Set cubes down in a row, the first as far ahead as the hand gets.

    Args:
        trial: The attempt.
        on: The condition to reach: a top on its bottom.
        spare: Cubes that the goal does not need.
        line: Along which the row will be pushed.
        out_m: None if the top of the goal is the first of the row; else it is put on
            the first, and stands out ahead by this distance [m].

    Returns:
        The cubes that stand on the table, the first first; empty if that failed.
    """
    row = [on.top, *spare] if out_m is None else list(spare)
    for i in range(_SPOTS):
        before_m = line.before_m(trial.placement.base) - trial.reach.grasp_m
        spot = line.at(before_m + 0.01 + i * _STEP_M)
        # Another cube may be put on the first, and a little ahead.
        ahead = spot @ Pose2(CUBE_EDGE_M / 2, 0.0)
        if trial.can(leaning(Pose2(ahead.x, ahead.y, spot.yaw), _HIGH_M)):
            break
    else:
        return []
    first_m = line.before_m(spot)
    for i, name in enumerate(row):
        if not trial.set_down(name, line.at(first_m + row_m(i))):
            return []
    if out_m is not None:
        upper = line.at(line.before_m(trial.pose(row[0])) - out_m)
        if not trial.set_down(on.top, upper, CUBE_EDGE_M):
            return []
    return row


def cube_chain(trial: ControlTrial) -> None:
    """Pushes a cube to its pad with the cubes behind it in a row.

    Or a tower is the first of the row, and its upper cube tips over onto the pad where
    the lower one is stopped. The fingers of a leaning hand push the row.
    """
    number, out_m = _WAYS[trial.attempt]
    on = trial.goal.conjuncts[0]
    spare = [name for name in trial.spare() if trial.is_home(name)]
    trial.require(number is None or len(spare) > number)
    spare = spare[:number]
    trial.require(spare and trial.is_home(on.top))
    beyond_m = row_m(len(spare) + 1) + _SLIDE_M + kind_of(on.bottom).disc_m
    trial.require_near(on.bottom, trial.could.touch_m + beyond_m)
    line = line_to(trial, on)
    row = build_row(trial, on, spare, line, out_m)
    if not row:
        return
    start_m = line.before_m(trial.pose(row[-1])) + _BEHIND_M
    length_m = line.before_m(trial.pose(row[0])) + len(row) * _SLACK_M
    spots = [line.at(start_m - gone_m) for gone_m in _steps(length_m)]
    path = _farthest(trial, spots, _LOW_M, LEANS_RAD[:14])
    if not path or not trial.approach(path[0], 0.0, lift_m=0.06):
        return

    def push(speed_m_s: float) -> None:
        trial.lead(path, 0.0, speed_m_s)
        trial.lead([moved(path[0], dz=_RAISE_M)], 0.0, 0.2)
        trial.wait(_REST_S, 0.0)

    trial.try_each(_SPEEDS_M_S, push)


def hand_push(trial: ControlTrial) -> None:
    """Pushes a cube to its pad with the hand, or with a cube in it."""
    held_m = CUBE_EDGE_M if trial.attempt else 0.0
    for on in trial.goal.conjuncts:
        beyond_m = CUBE_EDGE_M / 2 + held_m + trial.support_m(on.bottom)
        trial.require_near(on.bottom, trial.could.touch_m + beyond_m)
    for on in trial.goal.conjuncts:
        _push_on(trial, on)


def _push_on(trial: ControlTrial, on: On) -> None:
    """Set a cube down in line with its pad near the edge of reach, and push it."""
    spot = trial.at(trial.reach.travel_m - 0.06, trial.outward(trial.pose(on.bottom)))
    put = leaning(spot, kind_of(on.top).origin_m + 0.003)
    if not trial.take(on.top) or not trial.can(put) or not trial.put(put, 0.08):
        return
    if trial.attempt and not any(map(trial.take, trial.spare())):
        return
    half_m = CUBE_EDGE_M / 2 if trial.attempt else _FINGERS_M
    cube, pad = trial.pose(on.top), trial.pose(on.bottom)
    start = Pose2(cube.x, cube.y, math.atan2(pad.y - cube.y, pad.x - cube.x))
    back_m = CUBE_EDGE_M / 2 + half_m + 0.015
    steps = _steps(cube.distance(pad) + 0.015)
    spots = [start @ Pose2(gone_m - back_m, 0.0) for gone_m in steps]
    # A position of the push keeps the heading as it is, without wrapping it.
    spots = [Pose2(at.x, at.y, start.yaw) for at in spots]
    path = _farthest(trial, spots, 0.03, LEANS_RAD[::2])
    if not path or not trial.stand_by(path[0], 0.0):
        return
    above = moved(path[0], dz=0.08)
    if trial.can(above):
        trial.go(above, 0.0)
    if trial.lead(path[:1], 0.0, 0.1):
        trial.lead(path[1:], 0.0, 0.1)
    trial.lead([moved(trial.hand(), dz=0.05)], 0.1, 0.2)


def _steps(length_m: float) -> list[float]:
    """Return the distances from the start of a push at which the hand is led [m]."""
    count = math.ceil(length_m / _STEP_M) + 1
    return [min(length_m, i * _STEP_M) for i in range(count)]


def _farthest(
    trial: ControlTrial, spots: Sequence[Pose2], z: float, leans: Sequence[float]
) -> list[FloatArray]:
    """Return the hands, of the one lean with which the robot gets farthest."""
    ways = ((leaning(spot, z, lean) for spot in spots) for lean in leans)
    return max((list(takewhile(trial.can, way)) for way in ways), key=len)


ATTACKS.add("hand_push", Attack(hand_push, "control", attempts=2, cheap=True))
ATTACKS.add("cube_chain", Attack(cube_chain, "control", attempts=len(_WAYS)))
