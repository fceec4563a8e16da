"""Reservations: exclusive sectors of the table that arms sweep.

Before a stage of a sub-task begins, its arm reserves all cells that it will sweep, from
its present position over its targets to its park posture ("home"). Sectors of two arms
never overlap: if a part is reserved already, the arm waits where it is. An arm on its
way home releases the cells that it has passed.

An arm may hold one sector and wait for another, so a cycle of waiting arms (deadlock)
is possible. Then the arm that began last carries its load home; its sector always
includes the way there. At home it holds no sector, and its next reservation covers the
rest of its sub-task. So each arm retreats at most once, and one arm can always proceed.
A sub-task that has waited for :data:`LONGEST_WAIT_S` ends as ``deadlock``. A free arm
that is not at home holds its way home (:mod:`lemma.motion.staying`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from lemma.core.poses import FloatArray, Pose2
from lemma.motion.arm_motion import ArmMotion
from lemma.motion.sectors import CELLS, Cells, clip, polar_of
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.robots.ur.kinematics import frames, top_down

BEYOND_M = 0.12
"""Margin beyond the gripper."""
BEYOND_STICK_M = 0.85
"""Margin beyond a gripper that holds the stick."""
BEYOND_HANDLE_M = 0.36
"""Margin beyond a gripper at one end of what two robots carry: up to its middle."""
PATIENCE_S = 0.5
"""Time after which a cycle of waiting arms is resolved."""
LONGEST_WAIT_S = 60.0
"""Longest time that an arm waits for others."""


class Verdict(Enum):
    """Order to an arm that has waited too long, or waits in a cycle."""

    RETREAT = "retreat"
    """Go home with the held object, and wait there."""
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
    """The sector, as computed last."""
    verdict: Verdict | None = None


@dataclass(slots=True)
class _Holder:
    """The reservation of one arm."""

    cells: Cells
    stops: FloatArray
    """Stops on its way, see :func:`_clip`; the last one is home."""
    beyond_m: float
    stays: bool = False
    """Whether its robot is free and has not moved since."""

    @property
    def goes_home(self) -> bool:
        """Whether the arm has no more targets."""
        return len(self.stops) == 1 and not self.stays


@dataclass(slots=True)
class WaitingTimes:
    """Waiting times of arms, with the numbers of retreats and deadlocks."""

    waited_s: dict[str, float] = field(default_factory=dict)
    """Total waiting time by robot [s]."""
    retreats: int = 0
    deadlocks: int = 0

    def copy(self) -> "WaitingTimes":
        """Return an independent copy."""
        return WaitingTimes(dict(self.waited_s), self.retreats, self.deadlocks)


class Reservations:
    """Sectors that the arms of one scene hold or wait for, by robot."""

    def __init__(self, arms: Mapping[str, ArmMotion]) -> None:
        """Start without reservations.

        Args:
            arms: Motion of every robot of the scene, by robot name.
        """
        self._arms = arms
        self._scene = next(iter(arms.values())).scene
        self._holders: dict[str, _Holder] = {}
        self.waits: dict[str, Wait] = {}
        """Waiting robots, with the robots that they wait for."""
        self.times = WaitingTimes()
        self._stuck_s: float | None = None

    @property
    def cells(self) -> dict[str, Cells]:
        """Reserved cells by robot."""
        return {name: holder.cells for name, holder in self._holders.items()}

    def is_alone(self, robot: str) -> bool:
        """Return whether no other robot holds a sector."""
        return self._holders.keys() <= {robot}

    def is_at_work(self, robot: str) -> bool:
        """Return whether a robot holds a sector for a sub-task, or waits for one."""
        holds = robot in self._holders and not self._holders[robot].stays
        return holds or robot in self.waits

    def ask(self, robot: str, goals: Sequence[Pose2], *, stick: bool = False) -> bool:
        """Replace an arm's sector by that from its present position over goals to home.

        Args:
            robot: The robot.
            goals: Poses at which it will work, in this order.
            stick: Whether it holds the stick, which reaches far beyond the gripper.

        Returns:
            Whether the robot has the new sector. If not, it keeps the old one, and
            :attr:`waits` has an entry for it.
        """
        wait = self.waits.get(robot)
        moves = robot in self._holders and self._holders[robot].goes_home
        if wait is not None and not moves:
            # The arm does not move, so its sector is unchanged.
            wait.holders = self._holders_of(wait.cells, robot)
            if wait.holders:
                return False
        stops, cells = self._stops(robot, goals), np.ones(CELLS, np.bool_)
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
            stops, cells = self._stops(robot, at), np.ones(CELLS, np.bool_)
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
        """Return whether an arm has no more targets and does not wait."""
        held = self._holders.get(robot)
        return held is not None and held.goes_home and robot not in self.waits

    def ask_for_home(self, robot: str) -> bool:
        """Reserve an arm's way home; every sector that is held already includes it."""
        if robot not in self._holders:
            return self.ask(robot, ())
        self._send_home(robot)
        self._end_wait(robot)
        return True

    def _send_home(self, robot: str) -> None:
        held = self._holders[robot]
        held.stops, held.stays = held.stops[-1:], False

    def stay(self, robot: str, *, stick: bool = False) -> None:
        """Reserve the way home of an arm that stays, except cells that others hold.

        Args:
            robot: The robot.
            stick: Whether it holds the stick.
        """
        self._end_wait(robot)
        if robot not in self._holders:
            stops, cells = self._stops(robot, ()), np.ones(CELLS, np.bool_)
            beyond = BEYOND_STICK_M if stick else BEYOND_M
            self._clip(robot, stops, beyond, cells)
            for other in self._holders.values():
                cells &= ~other.cells
            self._holders[robot] = _Holder(cells, stops, beyond)
        self._send_home(robot)
        self._holders[robot].stays = True

    def give_up(self, robot: str) -> None:
        """Release an arm's sector; if it waits, it goes on waiting."""
        self._holders.pop(robot, None)

    def release(self, robot: str) -> None:
        """Release an arm's sector and end its wait."""
        self.give_up(robot)
        self._end_wait(robot)
        if not self._holders:
            self._stuck_s = None

    def clear(self, times: WaitingTimes) -> None:
        """Remove all reservations; continue to count from the given times."""
        self._holders, self.waits, self._stuck_s = {}, {}, None
        self.times = times.copy()

    def _end_wait(self, robot: str) -> None:
        wait = self.waits.pop(robot, None)
        if wait is not None:
            waited = self.times.waited_s
            waited[robot] = waited.get(robot, 0.0) + self._scene.time_s - wait.since_s

    def follow(self) -> None:
        """Release the cells that moving arms have passed."""
        for robot, held in self._holders.items():
            if robot not in self.waits or held.goes_home:
                self._clip(robot, held.stops, held.beyond_m, held.cells)

    def judge(self, order: Sequence[str]) -> None:
        """Resolve cycles of waiting arms, and end waits that are too long.

        Args:
            order: Busy robots, in the order in which their sub-tasks began.
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
        """Return the robots that hold a sector and wait for each other in cycles.

        Robots with a verdict are left out, because they will release their sectors.
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
        """Return the stops of an arm that works at goals and goes home, (k, 3)."""
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
        """Remove the cells that an arm does not sweep from its present position."""
        arm = self._arms[robot]
        base = arm.robot.placement.base
        tcp, polar = arm.tcp_pose(), polar_of(base.x, base.y)
        clip(polar, base.x, base.y, tcp, arm.state[0, 0], stops, beyond_m, cells)
