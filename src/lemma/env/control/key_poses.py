"""Key poses of the gripper, and the waypoints between them.

A key pose is a pose at which a hand closes, opens or pushes. The motion between two key
poses is always the same: the hand approaches from above, goes straight down, opens or
closes, rises, and the arm returns to its waiting posture, out of the cameras' view. One
arm moves at a time; the others hold their pose.

Waypoints are actions of the control mode ``ee_waypoint``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import (
    FloatArray,
    matrix_from_quaternion,
    quaternion_from_matrix,
    wrap,
)
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.robots.ur.kinematics import top_down

CONTROL = "ee_waypoint"
"""The control mode of the waypoints."""
CONTROL_HZ = 20.0
"""Waypoints per second."""

Rows = NDArray[np.float32]
"""Actions, (steps, robots, 8): position [m] and quaternion wxyz in the frame of each
robot's base, and opening of the gripper [m]."""
Stand = tuple[float, float, float, float]
"""Pose of a gripper that points down: x, y, z [m] and yaw [rad], in the world."""

FULL_M = 0.012
"""A hand that was closed and is open at least this far holds something [m]."""

_FAST_M_S = 0.5
_GENTLE_M_S = 0.12
_MEETING_M_S = 0.1
_DRAG_M_S = 0.2
_GENTLE_M = 0.03
_MEETING_M = 0.05
_SETTLE_S = 0.35
_FINGERS_S = 0.5
_STAY_S = 0.8
_RETREAT_M = 0.13
_LIFT_M = 0.15
_WITHDRAWAL_M = 0.03
_ASIDE_M = 0.03
_LAY_M = 0.0195
_NEAR_M, _NEAR_RAD = 0.012, 0.06
"""Tolerances for reaching a waypoint that is not approached in a straight line."""
_LONGEST_S = 6.0
_PATIENCE_S = 0.2
_TURN_RAD_S = 1.4
"""Approximate speed of an arm that swings around its base."""


class Kind(StrEnum):
    """Kinds of key poses, by the action of the hand."""

    STOP = "stop"
    """Nothing: the work is done."""
    OVER = "over"
    """The open hand stays there."""
    PICK = "pick"
    """The hand closes and rises, and the arm returns to its waiting posture with the
    object."""
    RAISE = "raise"
    """The hand closes, rises and stays, because its object is too long to be
    carried."""
    TAKE = "take"
    """The hand closes and stays."""
    PUT = "put"
    """The hand opens and rises, and the arm returns to its waiting posture."""
    POKE = "poke"
    """The hand pushes the stick to the pose in a straight line, draws it back, lays it
    down and returns."""
    HOOK = "hook"
    """The same, with a hook that is pulled and then pushed off to the side."""


KINDS = tuple(Kind)


@dataclass(frozen=True, slots=True)
class KeyPose:
    """The next pose of a gripper that points down."""

    robot: int
    """Number of the robot that moves; -1 for none."""
    kind: Kind
    x: float
    """World frame [m]."""
    y: float
    z: float
    yaw: float
    """Direction of the gripper's x axis, or of a long object that it holds [rad]."""

    @property
    def stand(self) -> Stand:
        """Pose of the gripper."""
        return (self.x, self.y, self.z, self.yaw)


NOWHERE = KeyPose(-1, Kind.STOP, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a motion."""

    stand: Stand
    opening_m: float
    speed_m_s: float = 0.0
    """Speed along a straight line; 0 for any path, at full speed."""
    wait_s: float = 0.0
    """Time to wait at its end."""


@dataclass(frozen=True, eq=False)
class Progress:
    """State of the motion to a key pose; plain data."""

    rows: FloatArray
    """Target of each hand: pose and opening, (robots, 5)."""
    homes: FloatArray
    """Waiting poses of the arms, (robots, 5)."""
    robot: int = 0
    legs: tuple[Leg, ...] = ()
    """Remaining legs, in order."""
    waited_s: float = -1.0
    """Time since the first leg began; -1 before."""
    turned: bool = False
    """Whether the hand is half a turn away from the yaw of its key pose."""

    @classmethod
    def begin(cls, hands: Sequence[FloatArray], openings: FloatArray) -> "Progress":
        """Return the initial state of an episode, in which all arms wait.

        Args:
            hands: Poses of the tool centre points in the world, (4, 4) each.
            openings: Openings of the grippers [m].
        """
        rows = np.array(
            [[*_stand_of(h), o] for h, o in zip(hands, openings, strict=True)]
        )
        homes = rows.copy()
        homes[:, 4] = FINGER_OPENING_M
        return cls(rows, homes)


def set_out(progress: Progress, key: KeyPose, hand: FloatArray) -> Progress:
    """Return the motion to a key pose.

    Args:
        progress: The motions before it.
        key: The key pose.
        hand: Present pose of that robot's tool centre point, (4, 4).
    """
    if key.kind is Kind.STOP:
        return replace(progress, legs=())
    yaw, turned = key.yaw, progress.turned
    if key.kind in (Kind.OVER, Kind.PICK, Kind.RAISE, Kind.TAKE):
        # The fingers are alike, so that half a turn makes no difference to a grasp.
        turned = abs(wrap(yaw - _stand_of(hand)[3])) > 0.5 * math.pi
    if turned:
        yaw += math.pi
    home = progress.homes[key.robot]
    at = (key.x, key.y, key.z, yaw)
    legs = tuple(_legs(key.kind, at, _stand_of(hand), home))
    return replace(progress, robot=key.robot, legs=legs, waited_s=-1.0, turned=turned)


def go_on(
    progress: Progress, bases: Sequence[FloatArray], hands: Sequence[FloatArray]
) -> tuple[Progress, Rows | None]:
    """Return the waypoints up to the next observation.

    Args:
        progress: The motion.
        bases: World from base of each robot, (4, 4).
        hands: Present poses of the tool centre points in the world, (4, 4).

    Returns:
        The motion after the waypoints, and the waypoints; None if the motion is over.
    """
    rows, chunk = progress.rows.copy(), []
    legs, waited_s, robot = list(progress.legs), progress.waited_s, progress.robot
    while legs:
        leg = legs[0]
        goal = np.array([*leg.stand, leg.opening_m])
        if leg.speed_m_s:
            start = rows[robot].copy()
            way = goal - start
            way[3] = wrap(way[3])
            seconds = math.dist(goal[:3], start[:3]) / leg.speed_m_s
            count = max(1, math.ceil(seconds * CONTROL_HZ))
            for i in range(1, count + 1):
                rows[robot] = start + way * (i / count)
                rows[robot, 4] = leg.opening_m
                chunk.append(rows.copy())
            chunk += [rows.copy()] * round(leg.wait_s * CONTROL_HZ)
            legs.pop(0)
            continue
        if waited_s >= 0.0:
            if _is_there(hands[robot], leg.stand) or waited_s > _LONGEST_S:
                legs.pop(0)
                waited_s = -1.0
                continue
            chunk += [rows.copy()] * round(_PATIENCE_S * CONTROL_HZ)
            waited_s += _PATIENCE_S
            break
        if chunk:
            break
        rows[robot] = goal
        waited_s = _estimate_s(hands[robot], leg.stand, bases[robot])
        chunk = [rows.copy()] * math.ceil(waited_s * CONTROL_HZ)
        break
    done = replace(progress, rows=rows, legs=tuple(legs), waited_s=waited_s)
    if not chunk:
        return done, None
    return done, commands(np.array(chunk), bases)


def stay(progress: Progress, bases: Sequence[FloatArray]) -> Rows:
    """Return waypoints that keep all arms where they are for a while."""
    count = round(_STAY_S * CONTROL_HZ)
    return commands(np.repeat(progress.rows[None], count, 0), bases)


def commands(stands: FloatArray, bases: Sequence[FloatArray]) -> Rows:
    """Return stands and openings, (steps, robots, 5), as actions."""
    found = np.empty((*stands.shape[:2], 8), np.float32)
    for robot, base in enumerate(bases):
        last: list[float] = []
        for step, row in enumerate(stands[:, robot].tolist()):
            if row == last:
                found[step, robot] = found[step - 1, robot]
                continue
            last = row
            pose = _seen_from(base, top_down(*row[:4]))
            found[step, robot, :3] = pose[:3, 3]
            found[step, robot, 3:7] = quaternion_from_matrix(pose[:3, :3])
            found[step, robot, 7] = row[4]
    return found


def _seen_from(base: FloatArray, pose: FloatArray) -> FloatArray:
    """Return a pose in the world, (4, 4), in the frame of a base, (4, 4)."""
    found = np.eye(4)
    b, p = base.tolist(), pose.tolist()
    away = [p[k][3] - b[k][3] for k in range(3)]
    # Add term by term, so that the last bit does not depend on a library.
    for i in range(3):
        for j in range(3):
            found[i, j] = b[0][i] * p[0][j] + b[1][i] * p[1][j] + b[2][i] * p[2][j]
        found[i, 3] = b[0][i] * away[0] + b[1][i] * away[1] + b[2][i] * away[2]
    return found


def pose_matrices(rows: FloatArray) -> list[FloatArray]:
    """Return positions and quaternions wxyz, (7 n,) or (n, 7), as transforms."""
    found = []
    for row in np.asarray(rows, float).reshape(-1, 7):
        matrix = np.eye(4)
        matrix[:3, :3] = matrix_from_quaternion(tuple(row[3:]))
        matrix[:3, 3] = row[:3]
        found.append(matrix)
    return found


def _stand_of(hand: FloatArray) -> Stand:
    x, y, z = (float(hand[i, 3]) for i in range(3))
    return (x, y, z, math.atan2(hand[1, 0], hand[0, 0]))


def _is_there(hand: FloatArray, stand: Stand) -> bool:
    x, y, z, yaw = _stand_of(hand)
    near = math.dist((x, y, z), stand[:3]) < _NEAR_M
    return near and abs(wrap(yaw - stand[3])) < _NEAR_RAD


def _estimate_s(hand: FloatArray, stand: Stand, base: FloatArray) -> float:
    """Return the approximate time that an arm needs to reach a pose [s]."""
    here = _stand_of(hand)
    at = base[:2, 3]
    bearings = [math.atan2(p[1] - at[1], p[0] - at[0]) for p in (here, stand)]
    swing = abs(wrap(bearings[1] - bearings[0])) / _TURN_RAD_S
    turn = abs(wrap(stand[3] - here[3])) / (2.0 * _TURN_RAD_S)
    straight = math.dist(here[:3], stand[:3]) / (2.0 * _FAST_M_S)
    return 0.4 + max(swing, turn, straight)


def _raised(stand: Stand, z: float) -> Stand:
    return (stand[0], stand[1], max(stand[2], z), stand[3])


def _legs(kind: Kind, at: Stand, hand: Stand, home: FloatArray) -> list[Leg]:
    """Return the motion to a key pose, and the motion that follows there.

    Args:
        kind: Kind of the key pose; not ``STOP``.
        at: The key pose.
        hand: Present pose of the hand.
        home: Waiting pose of the arm, (5,).
    """
    if kind in (Kind.POKE, Kind.HOOK):
        return _drag(at, hand, home, poking=kind is Kind.POKE)
    over = _raised(at, TRAVEL_HEIGHT_M)
    if kind is Kind.PUT:
        near = (*at[:2], at[2] + _GENTLE_M, at[3])
        way = [Leg(over, 0.0), Leg(near, 0.0, _FAST_M_S)]
        return [*way, Leg(at, 0.0, _GENTLE_M_S, _SETTLE_S), *_leave(at, home)]
    # A goal must hold for a while.
    wait_s = _STAY_S if kind is Kind.OVER else _SETTLE_S
    legs = [Leg(over, FINGER_OPENING_M)]
    legs.append(Leg(at, FINGER_OPENING_M, _FAST_M_S, wait_s))
    if kind is not Kind.OVER:
        legs.append(Leg(at, 0.0, _FAST_M_S, _FINGERS_S))
    if kind in (Kind.PICK, Kind.RAISE):
        up = _raised(at, max(TRAVEL_HEIGHT_M, at[2] + _LIFT_M))
        legs.append(Leg(up, 0.0, _FAST_M_S, _SETTLE_S))
    if kind is Kind.PICK:
        legs.append(_to(home, 0.0))
    return legs


def _to(home: FloatArray, opening_m: float) -> Leg:
    x, y, z, yaw = home[:4].tolist()
    return Leg((x, y, z, yaw), opening_m)


def _leave(at: Stand, home: FloatArray) -> list[Leg]:
    """Return the legs in which the hand opens and the arm returns."""
    up = (*at[:2], at[2] + _RETREAT_M, at[3])
    return [
        Leg(at, FINGER_OPENING_M, _FAST_M_S, _FINGERS_S),
        Leg(up, FINGER_OPENING_M, _FAST_M_S),
        _to(home, FINGER_OPENING_M),
    ]


def _drag(at: Stand, hand: Stand, home: FloatArray, *, poking: bool) -> list[Leg]:
    """Return the legs of a push or pull with the stick, up to laying it down."""
    start: Stand = (*hand[:2], at[2], hand[3])
    t = min(1.0, _MEETING_M / max(1e-6, math.dist(start[:2], at[:2])))
    x, y = (a + t * (b - a) for a, b in zip(start[:2], at[:2], strict=True))
    met: Stand = (x, y, at[2], start[3] + t * wrap(at[3] - start[3]))
    # Where the stick points, from the hand to its hook.
    along = math.atan2(at[1] - start[1], at[0] - start[0])
    along += 0.0 if poking else math.pi
    last = _beside(at, along, -_WITHDRAWAL_M if poking else _WITHDRAWAL_M)
    legs = [
        Leg(start, 0.0, _GENTLE_M_S),
        Leg(met, 0.0, _MEETING_M_S),
        Leg(at, 0.0, _DRAG_M_S, _SETTLE_S),
        Leg(last, 0.0, _DRAG_M_S, _SETTLE_S),
    ]
    if not poking:
        # The bar of the hook lies to the left of the handle: free it to the right.
        last = _beside(last, along - 0.5 * math.pi, _ASIDE_M)
        legs.append(Leg(last, 0.0, _DRAG_M_S, _SETTLE_S))
    laid: Stand = (*last[:2], _LAY_M, last[3])
    return [*legs, Leg(laid, 0.0, _GENTLE_M_S, _SETTLE_S), *_leave(laid, home)]


def _beside(stand: Stand, bearing: float, away_m: float) -> Stand:
    x, y = stand[0] + away_m * math.cos(bearing), stand[1] + away_m * math.sin(bearing)
    return (x, y, *stand[2:])
