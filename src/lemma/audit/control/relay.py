"""A row of cubes and the stick behind it, pushed to a pad farther than any of them."""

from typing import Any

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.control.push import Line, build_row, line_to, row_m
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
from lemma.audit.control_trial import STEP_S, ControlTrial
from lemma.audit.hand import LEANS_RAD, ahead, drawn_back, leaning, moved
from lemma.audit.pushes import END_GRASP
from lemma.core.poses import Pose2
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M
from lemma.tasks.drags import stick_gap
from lemma.tasks.goal import On

# How far left of the base the line passes [m], how far the upper cube of a tower
# stands out, None without one [m], and whether the last push has a run-up; by
# attempt.
_WAYS: tuple[tuple[float, float | None, bool], ...] = (
    (-0.17, None, False),
    (-0.20, None, False),
    (-0.17, 0.016, False),
    (-0.17, 0.016, True),
    (-0.20, 0.022, True),
)
_GRASPS = (Pose2(0.43, 0.0), Pose2(0.25, 0.0), Pose2(0.02, 0.0))
# Where along the handle the stick is held, one after the other.
_FIRST, _LAST = _GRASPS[0], _GRASPS[-1]
_SLOW_M_S = 0.05
_FAST_M_S = 1.2
# Accelerations of a run-up; with more the upper cube of a tower slides back.
_RUNS_M_S2 = (0.2, 0.4, 0.7, 1.0, 1.5)
# From the base to the hand where a run-up begins.
_START_M = 0.42
_STEP_M = 0.01
# Shorter pushes are not worth the time.
_LEAST_M = 0.02
_LEAN_COST_M = 0.04
_GAIN_M = 0.005
# Tolerance of the gaps in the row and behind it.
_SLACK_M = 0.03
_NEAR_M = 0.02
_PUSHES = 6
# Cubes that the goal does not need, fetched with the stick if there are fewer.
_SPARE = 2


def stick_relay(trial: ControlTrial) -> None:
    """Pushes a row of cubes with the stick, and the stick's end by hand.

    The stick is held ever nearer to its end, then pushed end-on by the closed fingers.
    The first of the row is the cube itself, or a tower with it on top, which tips over
    onto the pad where the lower cube is stopped.
    """
    require_stick(trial)
    on, others = trial.goal.conjuncts[0], trial.spare()
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
    beside_m, out_m, runs_up = _WAYS[trial.attempt]
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
        """Distance from the pad's middle at which the head has arrived: a tower stops
        at the pad, a cube goes onto it."""

    def left_m(self) -> float:
        """Return how far the row is still to go [m]."""
        return self.line.before_m(self.trial.pose(self.first)) - self.short_m

    def grip(self, grasp: Pose2) -> Pose2:
        """Return the pose of a gripper with a grasp where the stick is now."""
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
        """Push with the stick in the hand, and where that ends, push its end."""
        for _ in range(_PUSHES):
            if self.left_m() < _NEAR_M:
                break
            if not self._push_held():
                self._push_end_on()
                break
        self.trial.wait(2.2)

    def run_up(self) -> None:
        """Push ever faster along all that the hand can go, and try how fast.

        The row slides on a little where the hand ends, and the upper cube on the lower.
        """
        short_m = _START_M - self.trial.radius(self.grip(_LAST))
        if short_m > 0.0:
            length_m, lean = self._longest(self.grip(_FIRST), short_m)
            if not self._push_once(_FIRST, length_m, lean):
                return
        length_m, lean = self._longest(self.grip(_LAST), self.left_m() + _SLACK_M)
        if not grasp_stick(self.trial, _LAST, lean):
            return

        def run(faster_m_s2: float) -> None:
            self._advance(length_m, faster_m_s2)
            # Nothing that is held at the end counts, so the stick is let go.
            self.trial.wait(2.2)

        self.trial.try_each(_RUNS_M_S2, run)

    def _push_held(self) -> bool:
        """Push with the stick in the hand; False where the hand gets no farther."""
        left_m = self.left_m() + _SLACK_M
        free = [(*self._longest(self.grip(g), left_m), g) for g in _GRASPS]
        length_m, lean, grasp = max(free, key=_worth)
        if length_m < _LEAST_M or not self._push_once(grasp, length_m, lean):
            return False
        return self.left_m() + _SLACK_M < left_m - _GAIN_M

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
        length_m, lean = self._longest(end, self.left_m() + _SLACK_M)
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
            if not self.trial.can(ahead(hand, length_m + _STEP_M, grip.yaw)):
                break
            length_m += _STEP_M
        return length_m

    def _advance(self, length_m: float, faster_m_s2: float = 0.0) -> None:
        """Lead the hand along the line, ever faster or slowly all the way."""
        start, done_m, speed = self.trial.hand(), 0.0, _SLOW_M_S
        while done_m < length_m:
            speed = min(_FAST_M_S, speed + faster_m_s2 * STEP_S)
            done_m += speed * STEP_S
            if not self.trial.follow(ahead(start, done_m, self.line.end.yaw), 0.0):
                return
        self.trial.settle(0.0)


def _worth(way: tuple[Any, ...]) -> float:
    """Return how good a length and a lean are: upright hands hold better."""
    return float(way[0] - _LEAN_COST_M * way[1])


ATTACKS.add("stick_relay", Attack(stick_relay, "control", attempts=len(_WAYS)))
