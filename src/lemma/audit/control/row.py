"""Attacks that push: a cube, a row of cubes, or a row and the stick behind it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

from lemma.audit.attack import attack
from lemma.audit.control.stick import (
    LOW_M,
    carry_over,
    either_way,
    grasp_stick,
    held_turn,
    hook_home,
    lay_stick,
    require_stick,
)
from lemma.audit.control_trial import (
    LEANS_RAD,
    STEP_S,
    ControlTrial,
    ahead,
    drawn_back,
    leaning,
    moved,
)
from lemma.audit.pushes import END_GRASP
from lemma.core.poses import FloatArray, Pose2
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M
from lemma.tasks.drags import stick_gap
from lemma.tasks.goal import On

# Gap between two cubes of a row when they are set down.
_GAP_M = 0.004
# Half the width of two closed fingers.
_FINGERS_M = 0.015
_STEP_M = 0.02
_HIGH_M = 0.20
_SPOTS = 12
# Number of spare cubes in the row (None: all) and overhang of the upper cube of a tower
# (None: no tower) [m]; by attempt.
_WAYS: tuple[tuple[int | None, float | None], ...] = (
    (None, None),
    (None, 0.013),
    (None, 0.018),
    (None, 0.023),
    (1, None),
    (1, 0.018),
    (1, 0.023),
)
# Speeds of the push; a fast row slides on after the push.
_SPEEDS_M_S = (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.65, 0.8)
_BEHIND_M = CUBE_EDGE_M / 2 + 0.035
_LOW_M = 0.02
_SLIDE_M = 0.10
_RAISE_M = 0.08
_REST_S = 1.5
_SLACK_M = 0.015


@dataclass(frozen=True)
class Line:
    """A line along which objects are pushed; it ends in the middle of a pad."""

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
    """Return the line to a pad that passes the base on its left at a distance [m]."""
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
        out_m: None if the goal's top is the first cube of the row; otherwise it is put
            on the first cube with this overhang in the direction of the push [m].

    Returns:
        The cubes that stand on the table, from the head of the row; empty if building
        failed.
    """
    row = [on.top, *spare] if out_m is None else list(spare)
    for i in range(_SPOTS):
        before_m = line.before_m(trial.placement.base) - trial.reach.grasp_m
        spot = line.at(before_m + 0.01 + i * _STEP_M)
        # The hand must also be able to put a cube on the first, a little ahead.
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


@attack("control", attempts=2, cheap=True)
def hand_push(trial: ControlTrial) -> None:
    """Pushes a cube to its pad with the hand, or with a cube in it."""
    held_m = CUBE_EDGE_M if trial.attempt else 0.0
    for on in trial.goal.placements:
        beyond_m = CUBE_EDGE_M / 2 + held_m + trial.support_m(on.bottom)
        trial.require_near(on.bottom, trial.could.touch_m + beyond_m)
    for on in trial.goal.placements:
        _push_on(trial, on)


@attack("control", attempts=len(_WAYS), candidates=len(_SPEEDS_M_S))
def cube_chain(trial: ControlTrial) -> None:
    """Pushes a cube to its pad with the cubes behind it in a row.

    In some attempts a tower heads the row: the pad stops its lower cube, and the upper
    one tips over onto the pad. The fingers of a leaning hand push the row.
    """
    number, out_m = _WAYS[trial.attempt]
    on = trial.goal.placements[0]
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
    # Pose2 @ wraps the yaw; all poses of the push keep the same number.
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
    """Return the distances of the hand's poses from the start of a push [m]."""
    count = math.ceil(length_m / _STEP_M) + 1
    return [min(length_m, i * _STEP_M) for i in range(count)]


def _farthest(
    trial: ControlTrial, spots: Sequence[Pose2], z: float, leans: Sequence[float]
) -> list[FloatArray]:
    """Return the feasible hands along spots, with the lean that gets farthest."""
    ways = ((leaning(spot, z, lean) for spot in spots) for lean in leans)
    return max((list(takewhile(trial.can, way)) for way in ways), key=len)


# Distance of the line left of the base [m], overhang of the upper cube of a tower [m]
# (None: no tower), and whether the last push has a run-up; by attempt.
_RELAYS: tuple[tuple[float, float | None, bool], ...] = (
    (-0.17, None, False),
    (-0.20, None, False),
    (-0.17, 0.016, False),
    (-0.17, 0.016, True),
    (-0.20, 0.022, True),
)
_GRASPS = (Pose2(0.43, 0.0), Pose2(0.25, 0.0), Pose2(0.02, 0.0))
# First and last grasp along the handle.
_FIRST, _LAST = _GRASPS[0], _GRASPS[-1]
_SLOW_M_S = 0.05
_FAST_M_S = 1.2
# Accelerations of a run-up; a larger one makes a tower's upper cube slide back.
_RUNS_M_S2 = (0.2, 0.4, 0.7, 1.0, 1.5)
# Distance from the base to the hand at the start of a run-up.
_START_M = 0.42
_FINE_STEP_M = 0.01
# Shorter pushes are not worth the time.
_LEAST_M = 0.02
_LEAN_COST_M = 0.04
_GAIN_M = 0.005
# Tolerance of the gaps in the row and behind it.
_GAP_SLACK_M = 0.03
_NEAR_M = 0.02
_PUSHES = 6
# Wanted number of spare cubes within reach; the stick fetches missing ones.
_SPARE = 2


@attack("control", attempts=len(_RELAYS), candidates=len(_RUNS_M_S2), simulated_s=150.0)
def stick_relay(trial: ControlTrial) -> None:
    """Pushes a row of cubes with the stick, and the stick's end by hand.

    Each grasp is nearer to the stick's end; at last the closed fingers push the end
    itself. The head of the row is the cube, or a tower with the cube on top: the pad
    stops the lower cube, and the upper one tips over onto the pad.
    """
    require_stick(trial)
    on, others = trial.goal.placements[0], trial.spare()
    trial.require(others and kind_of(on.bottom).fixed)
    beyond_m = HANDLE_LENGTH_M + row_m(len(others) + 1) + kind_of(on.bottom).disc_m
    trial.require_near(on.bottom, trial.could.touch_m + beyond_m)
    if not _fetch(trial, on.top):
        return
    spare = [name for name in others if trial.is_home(name)]
    for name in [name for name in others if name not in spare][::-1]:
        if len(spare) < _SPARE and _fetch(trial, name):
            spare.append(name)
    if not spare:
        return
    beside_m, out_m, runs_up = _RELAYS[trial.attempt]
    line = line_to(trial, on, beside_m)
    row = build_row(trial, on, spare, line, out_m)
    if not row:
        return
    relay = _Relay(trial, on, line, row[0])
    if relay.lay_behind(row[-1]):
        if runs_up:
            relay.run_up()
        else:
            relay.push()


def _fetch(trial: ControlTrial, name: str) -> bool:
    """Hook a cube home if need be, and lay the stick down; False if that fails."""
    if not trial.is_home(name):
        if not hook_home(trial, name):
            return False
        lay_stick(trial, END_GRASP, _aside(trial))
    return trial.is_home(name)


def _aside(trial: ControlTrial) -> Pose2:
    """Return where the stick can lie, pointing outwards, farthest from all cubes."""

    def gap_m(stick: Pose2) -> float:
        cubes = (trial.pose(name) for name in trial.cargo())
        return min(stick_gap(stick, cube.x, cube.y) for cube in cubes)

    radius_m, yaw = 0.5 * trial.reach.travel_m, trial.placement.base.yaw
    grips = (trial.at(radius_m, yaw + 0.2 * turn) for turn in range(-7, 8))
    return max((grip @ END_GRASP.inverse() for grip in grips), key=gap_m)


class _Relay:
    """The stick behind a row of cubes, and the pushes that bring the row to a pad."""

    def __init__(self, trial: ControlTrial, on: On, line: Line, first: str) -> None:
        self.trial = trial
        self.line = line
        self.first = first
        """Cube at the head of the row."""
        edge_m = kind_of(on.bottom).disc_m + CUBE_EDGE_M / 2
        self.short_m = edge_m if first != on.top else 0.0
        """Distance from the pad's middle at which the head has arrived [m]: a tower
        stops at the pad, a cube goes onto it."""

    def left_m(self) -> float:
        """Return the remaining distance of the row [m]."""
        return self.line.before_m(self.trial.pose(self.first)) - self.short_m

    def grip(self, grasp: Pose2) -> Pose2:
        """Return the pose of the gripper for a grasp of the stick at its present pose.

        Args:
            grasp: Gripper in the stick's frame.
        """
        return self.trial.pose(STICK) @ grasp

    def lay_behind(self, last: str) -> bool:
        """Lay the stick along the line behind the row; False if that fails."""
        trial = self.trial
        if not grasp_stick(trial, _FIRST):
            return False
        behind_m = self.line.before_m(trial.pose(last)) + CUBE_EDGE_M / 2 + 0.012
        grip = self.line.at(behind_m + HANDLE_LENGTH_M) @ _FIRST @ held_turn(trial)
        put = leaning(grip, LOW_M)
        if not carry_over(trial, put, lift_m=0.14, over_m=0.14, speed=0.4):
            return False
        if not trial.lead([put], 0.0, 0.1):
            return False
        trial.wait(0.6)
        return trial.lead([moved(put, dz=0.10)], FINGER_OPENING_M, 0.2)

    def push(self) -> None:
        """Push with the stick in the hand as far as possible, then push its end."""
        for _ in range(_PUSHES):
            if self.left_m() < _NEAR_M:
                break
            if not self._push_held():
                self._push_end_on()
                break
        self.trial.wait(2.2)

    def run_up(self) -> None:
        """Push with a constant acceleration as far as the hand goes; try several.

        When the hand stops, the row slides on a little, and so does the upper cube on
        the lower one.
        """
        short_m = _START_M - self.trial.radius(self.grip(_LAST))
        if short_m > 0.0:
            length_m, lean = self._longest(self.grip(_FIRST), short_m)
            if not self._push_once(_FIRST, length_m, lean):
                return
        length_m, lean = self._longest(self.grip(_LAST), self.left_m() + _GAP_SLACK_M)
        if not grasp_stick(self.trial, _LAST, lean):
            return

        def run(faster_m_s2: float) -> None:
            self._advance(length_m, faster_m_s2)
            # An object held at the end does not count, so the fingers open.
            self.trial.wait(2.2)

        self.trial.try_each(_RUNS_M_S2, run)

    def _push_held(self) -> bool:
        """Push with the stick in the hand; False where the hand gets no farther."""
        left_m = self.left_m() + _GAP_SLACK_M
        free = [(*self._longest(self.grip(g), left_m), g) for g in _GRASPS]
        length_m, lean, grasp = max(free, key=_worth)
        if length_m < _LEAST_M or not self._push_once(grasp, length_m, lean):
            return False
        return self.left_m() + _GAP_SLACK_M < left_m - _GAIN_M

    def _push_once(self, grasp: Pose2, length_m: float, lean: float) -> bool:
        """Take the stick, push and let it go; False if it cannot be taken."""
        if not grasp_stick(self.trial, grasp, lean):
            return False
        self._advance(length_m)
        self.trial.wait(0.6)
        back = drawn_back(self.trial.hand(), 0.10)
        self.trial.lead([back], FINGER_OPENING_M, 0.2)
        return True

    def _push_end_on(self) -> None:
        """Push the stick's end with closed fingers."""
        end = self.grip(Pose2(-0.02, 0.0))
        length_m, lean = self._longest(end, self.left_m() + _GAP_SLACK_M)
        hand = leaning(either_way(self.trial, end), LOW_M, lean)
        if length_m < _LEAST_M or not self.trial.can(hand):
            return
        if self.trial.approach(hand, 0.0):
            self._advance(length_m)

    def _longest(self, grip: Pose2, most_m: float) -> tuple[float, float]:
        """Return how far the hand can go from a grip [m], and its lean then [rad]."""
        leans = LEANS_RAD[:14]
        return max(((self._free_m(grip, a, most_m), a) for a in leans), key=_worth)

    def _free_m(self, grip: Pose2, lean: float, most_m: float) -> float:
        """Return how far a hand of one lean can go along the stick from a grip [m]."""
        hand = leaning(either_way(self.trial, grip), LOW_M, lean)
        length_m = 0.0
        if not self.trial.can(hand, drawn_back(hand, 0.10)):
            return length_m
        while length_m < most_m:
            if not self.trial.can(ahead(hand, length_m + _FINE_STEP_M, grip.yaw)):
                break
            length_m += _FINE_STEP_M
        return length_m

    def _advance(self, length_m: float, faster_m_s2: float = 0.0) -> None:
        """Lead the hand along the line, with an acceleration or at a low speed."""
        start, done_m, speed = self.trial.hand(), 0.0, _SLOW_M_S
        while done_m < length_m:
            speed = min(_FAST_M_S, speed + faster_m_s2 * STEP_S)
            done_m += speed * STEP_S
            if not self.trial.follow(ahead(start, done_m, self.line.end.yaw), 0.0):
                return
        self.trial.settle(0.0)


def _worth(way: tuple[Any, ...]) -> float:
    """Return the value of a length and a lean; upright hands hold better."""
    return float(way[0] - _LEAN_COST_M * way[1])
