"""A row of cubes and the stick behind it, pushed to a pad farther than any of them.

The stick is held ever nearer to its end, then pushed end-on by the closed fingers. The
first of the row is the cube itself, or a tower whose upper cube it is. That one stands
out, to tip over onto the pad where the lower one is stopped.
"""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp, Lost
from lemma.audit.chain.row import (
    GAP_M,
    Line,
    build_row,
    fetch,
    line_to,
    put_on_first,
)
from lemma.audit.control.stick_in_hand import (
    either_way,
    grasp_stick,
    hand_at,
    require_stick,
)
from lemma.audit.control_trial import STEP_S, ControlTrial
from lemma.audit.hand import LEANS_RAD, drawn_back, moved
from lemma.audit.handling import approach, is_home
from lemma.core.poses import Pose2, wrap
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M, STICK_GRASP_HEIGHT_M
from lemma.tasks.goal import On

_WAYS: tuple[tuple[float, float | None, bool], ...] = (
    (-0.17, None, False),
    (-0.20, None, False),
    (-0.17, 0.016, False),
    (-0.17, 0.016, True),
    (-0.20, 0.022, True),
)
"""How far left of the base the line passes [m], how far the upper cube of a tower
stands out, None without one [m], and whether the last push has a run-up; by attempt."""
_GRASPS_M = (0.43, 0.25, 0.02)
"""Where along the handle the stick is held, one after the other."""
_SLOW_M_S = 0.05
_FAST_M_S = 1.2
_RUNS_M_S2 = (0.2, 0.4, 0.7, 1.0, 1.5)
"""How gently a tower is made faster: its upper cube shall not slide back."""
_START_M = 0.42
"""From the base to the hand where such a push begins."""
_STEP_M = 0.01
_LOW_M = STICK_GRASP_HEIGHT_M + 0.002
_LEAST_M = 0.02
"""Shorter pushes are not worth the time."""
_LEAN_COST_M = 0.04
_GAIN_M = 0.005
_SLACK_M = 0.03
"""Of the gaps in the row and behind it."""
_NEAR_M = 0.02
_PUSHES = 6
_SPARE = 2
"""Cubes that the goal does not need, fetched with the stick if there are fewer."""


def stick_relay(trial: ControlTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    on = trial.goal.conjuncts[0]
    others = [name for name in trial.cargo() if name not in trial.goal.entities]
    pad, kind = trial.pose(on.bottom), kind_of(on.bottom)
    row_m = (len(others) + 1) * (CUBE_EDGE_M + GAP_M)
    farthest_m = trial.could.touch_m + HANDLE_LENGTH_M + row_m + kind.disc_m
    if not others or not kind.fixed or trial.radius(pad) > farthest_m:
        raise GiveUp
    if not fetch(trial, on.top):
        return
    spare = [name for name in others if is_home(trial, name)]
    far = [name for name in others if name not in spare]
    while far and len(spare) < _SPARE:
        name = far.pop()
        if fetch(trial, name):
            spare.append(name)
    if not spare:
        return
    beside_m, out_m, runs_up = _WAYS[trial.attempt]
    line = line_to(trial, pad, beside_m)
    row = spare if out_m is not None else [on.top, *spare]
    if not build_row(trial, row, line):
        return
    if out_m is not None and not put_on_first(trial, on.top, row[0], line, out_m):
        return
    if not _lay_behind(trial, line, row[-1]):
        return
    if runs_up:
        _push_with_run_up(trial, on, line, row[0])
        return
    for _ in range(_PUSHES):
        if _left_m(trial, on, line, row[0]) < _NEAR_M:
            break
        if not _push_held(trial, on, line, row[0]):
            _push_end_on(trial, on, line, row[0])
            break
    trial.wait(2.2, FINGER_OPENING_M)


def _left_m(trial: ControlTrial, on: On, line: Line, first: str) -> float:
    """Return how far the row is still to go [m]: onto the pad, a tower up to it."""
    short_m = kind_of(on.bottom).disc_m + CUBE_EDGE_M / 2 if first != on.top else 0.0
    return line.before_m(trial.pose(first)) - short_m


def _lay_behind(trial: ControlTrial, line: Line, last: str) -> bool:
    """Lay the stick along the line behind the row; False if that cannot be done."""
    grasp = Pose2(_GRASPS_M[0], 0.0)
    if not grasp_stick(trial, grasp):
        return False
    hand = trial.hand()
    held = wrap(math.atan2(hand[1, 0], hand[0, 0]) - trial.pose(STICK).yaw)
    turn = Pose2(0.0, 0.0, math.pi if abs(held) > 0.5 * math.pi else 0.0)
    behind_m = line.before_m(trial.pose(last)) + CUBE_EDGE_M / 2 + 0.012
    grip = line.at(behind_m + HANDLE_LENGTH_M) @ grasp @ turn
    put = hand_at(grip, _LOW_M)
    if not trial.lead([moved(hand, dz=0.14)], 0.0, 0.25):
        return False
    if not trial.go(moved(put, dz=0.14), 0.0, 0.4):
        return False
    if not trial.lead([put], 0.0, 0.1):
        return False
    trial.wait(0.6, FINGER_OPENING_M)
    return trial.lead([moved(put, dz=0.10)], FINGER_OPENING_M, 0.2)


def _push_held(trial: ControlTrial, on: On, line: Line, first: str) -> bool:
    """Push with the stick in the hand; False where the hand gets no farther."""
    left_m = _left_m(trial, on, line, first) + _SLACK_M
    free = []
    for grasp_m in _GRASPS_M:
        grip = trial.pose(STICK) @ Pose2(grasp_m, 0.0)
        free.append((*_longest(trial, grip, left_m), grasp_m))
    length_m, lean, grasp_m = max(free, key=_worth)
    if length_m < _LEAST_M or not grasp_stick(trial, Pose2(grasp_m, 0.0), lean):
        return False
    _advance(trial, line, length_m, 0.0)
    trial.wait(0.6, FINGER_OPENING_M)
    trial.lead([drawn_back(trial.hand(), 0.10)], FINGER_OPENING_M, 0.2)
    return _left_m(trial, on, line, first) + _SLACK_M < left_m - _GAIN_M


def _push_with_run_up(trial: ControlTrial, on: On, line: Line, first: str) -> None:
    """Push ever faster along all that the hand can go, and try how fast.

    The row slides on a little where the hand ends, and the upper cube on the lower.
    """
    end = trial.pose(STICK) @ Pose2(_GRASPS_M[-1], 0.0)
    short_m = _START_M - trial.radius(end)
    if short_m > 0.0:
        grasp = Pose2(_GRASPS_M[0], 0.0)
        length_m, lean = _longest(trial, trial.pose(STICK) @ grasp, short_m)
        if not grasp_stick(trial, grasp, lean):
            return
        _advance(trial, line, length_m, 0.0)
        trial.wait(0.6, FINGER_OPENING_M)
        trial.lead([drawn_back(trial.hand(), 0.10)], FINGER_OPENING_M, 0.2)
    grasp = Pose2(_GRASPS_M[-1], 0.0)
    most_m = _left_m(trial, on, line, first) + _SLACK_M
    length_m, lean = _longest(trial, trial.pose(STICK) @ grasp, most_m)
    if not grasp_stick(trial, grasp, lean):
        return
    ready = trial.snapshot()
    for faster_m_s2 in _RUNS_M_S2:
        trial.restore(ready)
        try:
            _advance(trial, line, length_m, faster_m_s2)
            # What is held at the end, the stick too, is no success.
            trial.wait(2.2, FINGER_OPENING_M)
        except Lost:
            continue


def _push_end_on(trial: ControlTrial, on: On, line: Line, first: str) -> None:
    """Push the stick's end with closed fingers."""
    end = trial.pose(STICK) @ Pose2(-0.02, 0.0)
    left_m = _left_m(trial, on, line, first) + _SLACK_M
    length_m, lean = _longest(trial, end, left_m)
    hand = hand_at(either_way(trial, end), _LOW_M, lean)
    if length_m < _LEAST_M or not trial.can(hand):
        return
    if not approach(trial, hand, 0.0):
        return
    _advance(trial, line, length_m, 0.0)


def _longest(trial: ControlTrial, grip: Pose2, most_m: float) -> tuple[float, float]:
    """Return how far the hand can go from a grip [m], and how it leans then."""
    free = [(_free_m(trial, grip, lean, most_m), lean) for lean in LEANS_RAD[:14]]
    return max(free, key=_worth)


def _worth(way: tuple[float, ...]) -> float:
    """Return how good a length and a lean are: upright hands hold better."""
    length_m, lean, *_ = way
    return length_m - _LEAN_COST_M * lean


def _free_m(trial: ControlTrial, grip: Pose2, lean: float, most_m: float) -> float:
    """Return how far a hand of one lean can go along the stick from a grip [m]."""
    hand = hand_at(either_way(trial, grip), _LOW_M, lean)
    if not trial.can(hand, drawn_back(hand, 0.10)):
        return 0.0
    x, y = math.cos(grip.yaw), math.sin(grip.yaw)
    length_m = 0.0
    while length_m < most_m:
        ahead_m = length_m + _STEP_M
        if not trial.can(moved(hand, ahead_m * x, ahead_m * y)):
            break
        length_m = ahead_m
    return length_m


def _advance(
    trial: ControlTrial, line: Line, length_m: float, faster_m_s2: float
) -> None:
    """Lead the hand along the line, ever faster or slowly all the way."""
    yaw, start = line.end.yaw, trial.hand()
    done_m, speed = 0.0, _SLOW_M_S
    while done_m < length_m:
        speed = min(_FAST_M_S, speed + faster_m_s2 * STEP_S)
        done_m += speed * STEP_S
        ahead = moved(start, done_m * math.cos(yaw), done_m * math.sin(yaw))
        joints = trial.posture(ahead)
        if joints is None:
            return
        trial.command(joints, 0.0)
    trial.settle(0.0)


ATTACKS.add(
    "stick_relay",
    Attack(
        name="stick_relay",
        summary="Pushes a row of cubes with the stick, and the stick's end by hand.",
        level="control",
        play=stick_relay,
        attempts=len(_WAYS),
    ),
)
