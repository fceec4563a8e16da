"""Reservations: the sectors of the table that arms sweep, one holder each.

Before a stage of a sub-task begins, its arm reserves all that it will sweep: from where
its hand is, as its base turns, to where it will work, and on to where it waits. Sectors
never overlap, so an arm whose sector is taken waits where it is. One that goes home
gives up what it has left behind.

An arm may hold one sector and wait for another, so arms may wait for each other in a
circle. Then the one that began last takes home what it carries, which it can always do:
its way home is part of what it holds. There it holds nothing, and what it reserves next
takes it to the end of its sub-task. So each retreats at most once, and some arm can go
on. A sub-task that has waited for :data:`LONGEST_WAIT_S` ends as ``deadlock``. An arm
that is free but not at home holds its way home (:mod:`lemma.motion.staying`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray, Pose2
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.robots.ur.kinematics import frames, top_down
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M

Cells = npt.NDArray[np.bool_]
"""Cells of the grid over the table, (n,)."""

MARGIN_M = 0.17
"""Kept free to each side of the line from a base to its hand. With 0.10 m two of twenty
pairs of arms touched: elbow and wrist do not lie on that line."""
BEYOND_M = 0.12
"""Kept free beyond the hand."""
BEYOND_STICK_M = 0.85
"""The same for a hand that holds the stick."""
BEYOND_HANDLE_M = 0.36
"""The same for a hand at one end of what two robots carry: up to its middle."""
PATIENCE_S = 0.5
"""A circle of arms that wait for each other is broken after this."""
LONGEST_WAIT_S = 60.0
"""An arm waits for others at most so long."""

_CELL_M = 0.05
_ACROSS, _DEEP = (
    2 * round(half_m / _CELL_M) for half_m in (TABLE_HALF_X_M, TABLE_HALF_Y_M)
)
_CELLS = _ACROSS * _DEEP


def cell_at(x: float, y: float) -> int | None:
    """Return the index of the cell at a place [m]; None beside the table."""
    column = math.floor(x / _CELL_M) + _ACROSS // 2
    row = math.floor(y / _CELL_M) + _DEEP // 2
    inside = 0 <= column < _ACROSS and 0 <= row < _DEEP
    return row * _ACROSS + column if inside else None


class Verdict(Enum):
    """Told to an arm that waits in a circle."""

    RETREAT = "retreat"
    """Go home with what is held, and wait there."""
    FAIL = "fail"
    """End the sub-task."""


@dataclass(slots=True)
class Wait:
    """An arm that waits for a sector."""

    since_s: float
    """Simulated time at which it began to wait [s]."""
    holders: tuple[str, ...]
    """Robots that hold a part of the sector."""
    cells: Cells
    """The sector, as it was when it was computed last."""
    verdict: Verdict | None = None


@dataclass(slots=True)
class _Holder:
    """All that an arm holds."""

    cells: Cells
    stops: FloatArray
    """Where it stops on its way, see :func:`_clip`; the last one is home."""
    beyond_m: float
    stays: bool = False
    """Whether its robot stays where it is, and has not moved since."""

    @property
    def goes_home(self) -> bool:
        """Whether it has no more work."""
        return len(self.stops) == 1 and not self.stays


@dataclass(slots=True)
class WaitingTimes:
    """How long arms waited for others, and how that was resolved."""

    waited_s: dict[str, float] = field(default_factory=dict)
    """By robot [s]."""
    retreats: int = 0
    deadlocks: int = 0

    def copy(self) -> "WaitingTimes":
        """Return the same numbers, which nobody else changes."""
        return WaitingTimes(dict(self.waited_s), self.retreats, self.deadlocks)


class Reservations:
    """Sectors of the arms of one scene, by robot."""

    def __init__(self, arms: Mapping[str, ArmMotion]) -> None:
        """Reserve nothing yet.

        Args:
            arms: Motion of every robot of the scene, by robot name.
        """
        self._arms = arms
        self._scene = next(iter(arms.values())).scene
        self._holders: dict[str, _Holder] = {}
        self.waits: dict[str, Wait] = {}
        """Robots that wait, and for whom."""
        self.times = WaitingTimes()
        self._stuck_s: float | None = None

    @property
    def cells(self) -> dict[str, Cells]:
        """Reserved cells by robot."""
        return {name: holder.cells for name, holder in self._holders.items()}

    def is_alone(self, robot: str) -> bool:
        """Whether no other robot holds a sector."""
        return self._holders.keys() <= {robot}

    def is_at_work(self, robot: str) -> bool:
        """Whether a robot holds a sector for a sub-task, or waits for one."""
        holds = robot in self._holders and not self._holders[robot].stays
        return holds or robot in self.waits

    def ask(self, robot: str, goals: Sequence[Pose2], *, stick: bool = False) -> bool:
        """Reserve what an arm sweeps from where it is, in place of what it holds.

        Args:
            robot: The arm.
            goals: Where it will work, in this order; from the last one it goes home.
            stick: Whether it holds the stick, which reaches far beyond the hand.

        Returns:
            Whether it has the sector now. If not, it keeps what it held, and
            :attr:`waits` says for whom it waits.
        """
        wait = self.waits.get(robot)
        moves = robot in self._holders and self._holders[robot].goes_home
        if wait is not None and not moves:
            # It stands still, so its sector is what it was.
            wait.holders = self._holders_of(wait.cells, robot)
            if wait.holders:
                return False
        stops, cells = self._stops(robot, goals), np.ones(_CELLS, np.bool_)
        beyond = BEYOND_STICK_M if stick else BEYOND_M
        self._clip(robot, stops, beyond, cells)
        holders = self._holders_of(cells, robot)
        if holders:
            if wait is None:
                self.waits[robot] = Wait(self._scene.time_s, holders, cells)
            else:
                wait.holders, wait.cells = holders, cells
            return False
        self._end_wait(robot)
        self._holders[robot] = _Holder(cells, stops, beyond)
        return True

    def ask_together(self, goals: Mapping[str, Sequence[Pose2]]) -> bool:
        """Reserve what arms sweep that carry one thing: the sectors of all, or none.

        Sectors of these arms may overlap: one clock leads them all.

        Args:
            goals: Where each will work, by robot; see :meth:`ask`.

        Returns:
            Whether all have their sectors. If not, :attr:`waits` says for whom the
            first one waits.
        """
        leader, wanted = next(iter(goals)), dict[str, _Holder]()
        for robot, at in goals.items():
            stops, cells = self._stops(robot, at), np.ones(_CELLS, np.bool_)
            self._clip(robot, stops, BEYOND_HANDLE_M, cells)
            wanted[robot] = _Holder(cells, stops, BEYOND_HANDLE_M)
        cells = np.logical_or.reduce([one.cells for one in wanted.values()])
        holders = self._holders_of(cells, *goals)
        if holders:
            wait = self.waits.setdefault(
                leader, Wait(self._scene.time_s, holders, cells)
            )
            wait.holders = holders
            return False
        self._end_wait(leader)
        self._holders |= wanted
        return True

    def _holders_of(self, cells: Cells, *but: str) -> tuple[str, ...]:
        """Return the other robots that hold some of these cells."""
        return tuple(
            name
            for name, other in self._holders.items()
            if name not in but and (cells & other.cells).any()
        )

    def holds(self, robot: str) -> bool:
        """Whether a robot holds a sector."""
        return robot in self._holders

    def is_going_home(self, robot: str) -> bool:
        """Whether an arm has no more work in its sub-task, and does not wait."""
        held = self._holders.get(robot)
        return held is not None and held.goes_home and robot not in self.waits

    def ask_for_home(self, robot: str) -> bool:
        """Reserve an arm's way home, which whoever holds a sector has already."""
        if robot not in self._holders:
            return self.ask(robot, ())
        self._send_home(robot)
        self._end_wait(robot)
        return True

    def _send_home(self, robot: str) -> None:
        held = self._holders[robot]
        held.stops, held.stays = held.stops[-1:], False

    def stay(self, robot: str, *, stick: bool = False) -> None:
        """Hold an arm's way home from where it stays, but for what others hold.

        Args:
            robot: The arm.
            stick: Whether it holds the stick.
        """
        self._end_wait(robot)
        if robot not in self._holders:
            stops, cells = self._stops(robot, ()), np.ones(_CELLS, np.bool_)
            beyond = BEYOND_STICK_M if stick else BEYOND_M
            self._clip(robot, stops, beyond, cells)
            for other in self._holders.values():
                cells &= ~other.cells
            self._holders[robot] = _Holder(cells, stops, beyond)
        self._send_home(robot)
        self._holders[robot].stays = True

    def give_up(self, robot: str) -> None:
        """Give up what an arm holds, though it may wait on."""
        self._holders.pop(robot, None)

    def release(self, robot: str) -> None:
        """Give up all that an arm holds and waits for."""
        self.give_up(robot)
        self._end_wait(robot)
        if not self._holders:
            self._stuck_s = None

    def clear(self, times: WaitingTimes) -> None:
        """Reserve nothing any more, and go on counting from some times."""
        self._holders, self.waits, self._stuck_s = {}, {}, None
        self.times = times.copy()

    def _end_wait(self, robot: str) -> None:
        wait = self.waits.pop(robot, None)
        if wait is not None:
            waited = self.times.waited_s
            waited[robot] = waited.get(robot, 0.0) + self._scene.time_s - wait.since_s

    def follow(self) -> None:
        """Give up what arms that move have left behind."""
        for robot, held in self._holders.items():
            if robot not in self.waits or held.goes_home:
                self._clip(robot, held.stops, held.beyond_m, held.cells)

    def judge(self, order: Sequence[str]) -> None:
        """Break circles of arms that wait for each other, and waits without end.

        Args:
            order: Busy robots, by the time at which their sub-tasks began.
        """
        now = self._scene.time_s
        for wait in self.waits.values():
            if now - wait.since_s > LONGEST_WAIT_S:
                self._tell(wait, Verdict.FAIL)
        stuck = self._stuck(order)
        if not stuck:
            self._stuck_s = None
        elif self._stuck_s is None:
            self._stuck_s = now
        elif now - self._stuck_s >= PATIENCE_S:
            self._tell(self.waits[stuck[-1]], Verdict.RETREAT)
            self._send_home(stuck[-1])

    def _tell(self, wait: Wait, verdict: Verdict) -> None:
        if wait.verdict is not verdict:
            wait.verdict = verdict
            self.times.retreats += verdict is Verdict.RETREAT
            self.times.deadlocks += verdict is Verdict.FAIL

    def _stuck(self, order: Sequence[str]) -> list[str]:
        """Return those who hold something and wait for each other, to no end.

        Those who have been told to go home, or have failed, will give up what they
        hold.
        """
        stuck = [
            robot
            for robot in order
            if robot in self._holders
            and robot in self.waits
            and self.waits[robot].verdict is None
        ]
        while True:
            left = [r for r in stuck if set(self.waits[r].holders) & set(stuck)]
            if left == stuck:
                return stuck
            stuck = left

    def _stops(self, robot: str, goals: Sequence[Pose2]) -> FloatArray:
        """Return where an arm stops that works at goals and goes home."""
        arm, stops = self._arms[robot], []
        turn = float(arm.state[0, 0])
        for goal in goals:
            stand = top_down(goal.x, goal.y, TRAVEL_HEIGHT_M, goal.yaw)
            posture = arm.solve_posture(stand)
            if posture is not None:
                turn = float(posture[0])
            stops.append((goal.x, goal.y, turn))
        placed = np.empty((7, 4, 4))
        frames(arm.robot.arm.dh, arm.robot.world_from_base, arm.park, placed)
        stops.append((*placed[6, :2, 3].tolist(), float(arm.park[0])))
        return np.array(stops)

    def _clip(
        self, robot: str, stops: FloatArray, beyond_m: float, cells: Cells
    ) -> None:
        """Take away the cells that an arm does not sweep from where it is."""
        arm = self._arms[robot]
        base = arm.robot.placement.base
        tcp, polar = arm.tcp_pose(), _polar(base.x, base.y)
        _clip(polar, base.x, base.y, tcp, arm.state[0, 0], stops, beyond_m, cells)


@kernel
def _clip(  # noqa: PLR0913 - one call is what makes it fast
    polar: FloatArray,
    x: float,
    y: float,
    tcp: FloatArray,
    joint: float,
    stops: FloatArray,
    beyond_m: float,
    out: Cells,
) -> None:
    """Take the cells out of ``out`` that an arm does not sweep on its way.

    Args:
        polar: Of the cells, see :func:`_polar`.
        x: Of the base [m].
        y: The same.
        tcp: World from the tool centre point, (4, 4).
        joint: Where the base is turned to [rad].
        stops: x, y of the hand [m] and turn of the base [rad] at each, (k, 3).
        beyond_m: Kept free beyond the hand [m].
        out: Cells that were its own, (n,); written.
    """
    farthest = math.hypot(tcp[0, 3] - x, tcp[1, 3] - y)
    for i in range(stops.shape[0]):
        farthest = max(farthest, math.hypot(stops[i, 0] - x, stops[i, 1] - y))
    swept = np.zeros(out.shape[0], np.bool_)
    at = math.atan2(tcp[1, 3] - y, tcp[0, 3] - x)
    for i in range(stops.shape[0]):
        # The hand is beside the plane of the arm, the more the nearer it is: a joint
        # says which way round and a bearing how far.
        bearing = math.atan2(stops[i, 1] - y, stops[i, 0] - x)
        turn = bearing - at
        turn += math.tau * round((stops[i, 2] - joint - turn) / math.tau)
        _sweep(polar, at, turn, farthest + beyond_m, swept)
        at, joint = bearing, stops[i, 2]
    for i in range(out.shape[0]):
        out[i] = out[i] and swept[i]


@kernel
def _sweep(
    polar: FloatArray, at: float, turn: float, farthest: float, out: Cells
) -> None:
    """Add the cells that an arm sweeps, as it turns from a bearing [rad], to ``out``.

    Args:
        polar: Of the cells, see :func:`_polar`.
        at: Bearing of the hand [rad].
        turn: How far it turns, positive to the left [rad].
        farthest: Cells farther from the base than this are not swept [m].
        out: Written, (n,).
    """
    for i in range(out.shape[0]):
        if out[i] or polar[0, i] > farthest:
            continue
        ahead = polar[1, i] - at if turn >= 0.0 else at - polar[1, i]
        while ahead < 0.0:
            ahead += math.tau
        while ahead >= math.tau:
            ahead -= math.tau
        slack = polar[2, i]
        out[i] = ahead <= abs(turn) + slack or ahead >= math.tau - slack


@lru_cache(maxsize=32)
def _polar(x: float, y: float) -> FloatArray:
    """Return distance [m] and bearing [rad] of each cell from a base, (3, n).

    The last row is the angle that :data:`MARGIN_M` has at that distance [rad].
    """
    # By ``math``: NumPy's functions differ between processors.
    across, deep = (
        [(i + 0.5) * _CELL_M for i in range(-count // 2, count // 2)]
        for count in (_ACROSS, _DEEP)
    )
    away = [(u - x, v - y) for v in deep for u in across]
    radius = [max(math.hypot(u, v), 1e-6) for u, v in away]
    bearing = [math.atan2(v, u) for u, v in away]
    return np.array(
        [radius, bearing, [math.asin(min(1.0, MARGIN_M / r)) for r in radius]]
    )
