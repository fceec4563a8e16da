"""Where the stick must be to drag or push a cube: pure geometry of the plane.

Sampling asks whether a robot could do it, the expert asks how. Both get their answer
here, so that what is sampled as solvable is what the expert then does.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from lemma.core.poses import Pose2, wrap
from lemma.robots.gripper import FINGER_CENTER_M, FINGER_DISC_M
from lemma.robots.reach import reach_of
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.stick import (
    GRASP_FROM_END_M,
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_SECTION_M,
)
from lemma.scene.spec import RobotPlacement
from lemma.scene.table import Gap, lies_on_table
from lemma.tasks.subtask import Primitive

LARGEST_HEADING_RAD = math.radians(100.0)
"""How far a stick that a robot shall pick up may point away from straight outward."""
PREPARE_GAP_M = 0.02
"""Between the stick and the cube before the drag: a cube turned by 45 degrees fits."""

_INNER_FACE_M = HANDLE_LENGTH_M - STICK_SECTION_M
_DIRECTION = {Primitive.HOOK: -1.0, Primitive.POKE: 1.0}
_STICK_CLEARANCE_M = STICK_SECTION_M / 2 + 0.012
HAND_CLEARANCE_M = FINGER_CENTER_M + FINGER_DISC_M
"""Around a hand that opens its fingers to take or leave the stick."""
LARGEST_TURN_RAD = math.radians(150.0)
"""How far the stick may turn, seen from the base of who carries it: with more, the last
joint would turn it the other way, through the arm."""
_GRIP_MARGIN_M = 0.015
_END_MARGIN_M = 0.05
_GOOD_MARGIN_M = 0.10
_BEARINGS_RAD = tuple(
    math.radians(d) for d in (0, 8, -8, 16, -16, 24, -24, 32, -32, 42, -42, 54, -54)
)
_LENGTHS_M = tuple(round(0.10 + 0.02 * i, 2) for i in range(20))
MIN_DRAG_M, MAX_DRAG_M = _LENGTHS_M[0], _LENGTHS_M[-1]
"""The shortest and the longest drag that is planned: what nobody could reach lies 0.35
to 0.42 m outside of the region in which robots work."""
_HOLD_MARGIN_M = 0.02
_LEAST_WITHDRAWAL_M = 0.03
_MOST_WITHDRAWAL_M = 0.15
_EDGE_M = 0.03
"""A dragged cube's middle keeps so far from the table's edges."""

Disc = tuple[float, float, float]
"""Something to keep clear of: x, y, radius [m]."""


@dataclass(frozen=True, slots=True)
class Drag:
    """One way to move a cube with the stick."""

    primitive: Primitive
    """``hook`` or ``poke``."""
    prepared: Pose2
    """Gripper where the stick is put down next to the cube."""
    end: Pose2
    """Gripper where the drag ends."""
    left: Pose2
    """Gripper where the stick is left lying, withdrawn from the cube."""
    cube: Pose2
    """Where the cube will be."""
    score: float


def grasp_on_stick(stick: Pose2) -> Pose2:
    """Return the gripper pose that grasps a stick lying at a pose."""
    return stick @ Pose2(GRASP_FROM_END_M, 0.0)


def heading_from(base: Pose2, stick: Pose2) -> float:
    """Return the angle in [0, pi] between a stick and the ray from a base to its grasp.

    A robot that lifts a stick which points back at its base hits its own arm with it.
    """
    grasp = grasp_on_stick(stick)
    outward = math.atan2(grasp.y - base.y, grasp.x - base.x)
    return abs(wrap(stick.yaw - outward))


def is_turned_too_far(base: Pose2, pick: Pose2, place: Pose2) -> bool:
    """Whether a robot that carries the stick would turn it through its own arm.

    Args:
        base: Of the robot.
        pick: Gripper where the stick is grasped, turned as the stick is.
        place: Gripper where it is put down.
    """
    headings = [
        wrap(grip.yaw - math.atan2(grip.y - base.y, grip.x - base.x))
        for grip in (pick, place)
    ]
    return abs(headings[1] - headings[0]) > LARGEST_TURN_RAD


def stick_in_grasp(gripper: Pose2) -> Pose2:
    """Return the stick's pose when the gripper holds its handle."""
    return gripper @ Pose2(-GRASP_FROM_END_M, 0.0)


def find_drag(
    primitive: Primitive,
    robot: RobotPlacement,
    receiver: RobotPlacement,
    cube: Pose2,
    obstacles: Sequence[Disc],
    kind: ObjectKind = CUBE,
    gap_m: Gap | None = None,
) -> Drag | None:
    """Find the best way for a robot to bring a cube into a robot's reach.

    Args:
        primitive: ``HOOK`` (towards the robot) or ``POKE`` (away from it).
        robot: The robot that drags.
        receiver: The robot that shall reach the cube then.
        cube: Where the cube is.
        obstacles: Discs that the stick and the cube keep clear of.
        kind: Kind of the dragged object, if it is no cube.
        gap_m: Where the table is missing; a cube that is dragged there falls.

    Returns:
        The drag that ends deepest in the receiver's reach, among equals the shortest
        and straightest; None if there is no way, or the kind cannot be dragged.
        Two drags at one angle to either side of the receiver's base end equally deep:
        rounding chooses between them. Scores are not rounded against it, because
        recorded episodes hold what was chosen; whether there is a drag, which is all
        that sampling asks, does not depend on it.
    """
    if kind.drag_m is None:
        return None
    found = [
        drag
        for turn in _BEARINGS_RAD
        for drag in _drags_along(primitive, robot, receiver, cube, turn, kind.drag_m)
    ]
    found.sort(key=lambda drag: -drag.score)
    for drag in found:
        if _is_free(drag, cube, obstacles, kind.disc_m, gap_m):
            return drag
    return None


def _drags_along(
    primitive: Primitive,
    robot: RobotPlacement,
    receiver: RobotPlacement,
    cube: Pose2,
    turn: float,
    half_m: float,
) -> Iterator[Drag]:
    """Yield the drags of one bearing that both robots' reach allows."""
    hooking = primitive is Primitive.HOOK
    reach, base = reach_of(robot.arm), robot.base
    wanted, there = reach_of(receiver.arm), receiver.base
    # A hook is pulled towards one's own base, a cube is poked towards the other's.
    straight = (
        math.atan2(cube.y - base.y, cube.x - base.x)
        if hooking
        else math.atan2(there.y - cube.y, there.x - cube.x)
    )
    bearing = straight + turn
    prepared = _gripper(primitive, cube, bearing, PREPARE_GAP_M, half_m)
    if reach.margin(base, prepared.x, prepared.y) < _GRIP_MARGIN_M:
        return
    sign = _DIRECTION[primitive]
    cos, sin = sign * math.cos(bearing), sign * math.sin(bearing)
    for length in _LENGTHS_M:
        moved = Pose2(cube.x + length * cos, cube.y + length * sin, bearing)
        margin = wanted.margin(there, moved.x, moved.y)
        if margin < _END_MARGIN_M:
            continue
        end = _gripper(primitive, moved, bearing, 0.0, half_m)
        if reach.hold_margin(base, end.x, end.y) < _HOLD_MARGIN_M:
            continue
        left = withdrawn(primitive, robot, end)
        if reach.margin(base, left.x, left.y) < _GRIP_MARGIN_M:
            continue
        score = min(margin, _GOOD_MARGIN_M) - 0.15 * length - 0.03 * abs(turn)
        yield Drag(primitive, prepared, end, left, moved, score)


def withdrawn(primitive: Primitive, robot: RobotPlacement, end: Pose2) -> Pose2:
    """Return where the gripper lets go of the stick after a drag.

    A hook is pushed out a little, a head is drawn back: so far that fingers fit around
    the cube, and that the robot can pick the stick up again.

    Args:
        primitive: ``HOOK`` or ``POKE``.
        robot: The robot that drags.
        end: Gripper where the drag ends, turned as the stick is.
    """
    back = _LEAST_WITHDRAWAL_M
    sign = -_DIRECTION[primitive]
    reach = reach_of(robot.arm)
    while True:
        left = end @ Pose2(sign * back, 0.0)
        inside = reach.margin(robot.base, left.x, left.y) >= _GRIP_MARGIN_M
        if inside or primitive is Primitive.HOOK or back >= _MOST_WITHDRAWAL_M:
            return left
        back += 0.01


def _contact(primitive: Primitive, half_m: float) -> tuple[float, float]:
    """Return a dragged cube in the stick's frame, by its half width [m].

    It is in the middle of the hook's free length, or of the head's outer face.
    """
    if primitive is Primitive.HOOK:
        across = 0.5 * (HOOK_LENGTH_M - STICK_SECTION_M) + STICK_SECTION_M / 2
        return _INNER_FACE_M - half_m, across
    return HANDLE_LENGTH_M + half_m, 0.5 * HOOK_LENGTH_M - STICK_SECTION_M / 2


def _gripper(
    primitive: Primitive, cube: Pose2, bearing: float, gap_m: float, half_m: float
) -> Pose2:
    """Return the gripper pose that has the cube in contact, or ``gap_m`` before it."""
    u, v = _contact(primitive, half_m)
    u += _DIRECTION[primitive] * gap_m
    stick = Pose2(cube.x, cube.y, bearing) @ Pose2(-u, -v)
    return grasp_on_stick(stick)


def _is_free(
    drag: Drag,
    cube: Pose2,
    obstacles: Sequence[Disc],
    disc_m: float,
    gap_m: Gap | None,
) -> bool:
    """Whether stick and cube meet nothing and the cube stays on the table.

    It looks at six places. Between two of them an object may be nearer, mostly beside
    the end of the hook: 10 of 6,594 ways found for 800 frozen instances lead past one
    by less than 5 mm. To look at more places would change recorded episodes.
    """
    for i in range(6):
        t = i / 5
        grip = Pose2(
            drag.prepared.x + t * (drag.end.x - drag.prepared.x),
            drag.prepared.y + t * (drag.end.y - drag.prepared.y),
            drag.end.yaw,
        )
        x = cube.x + t * (drag.cube.x - cube.x)
        y = cube.y + t * (drag.cube.y - cube.y)
        if not lies_on_table(gap_m, Pose2(x, y), _EDGE_M):
            return False
        stick = stick_in_grasp(grip)
        for ox, oy, radius in obstacles:
            if math.hypot(ox - x, oy - y) < radius + disc_m + 0.01:
                return False
            if math.hypot(ox - grip.x, oy - grip.y) < radius + HAND_CLEARANCE_M:
                return False
            if stick_gap(stick, ox, oy) < radius + _STICK_CLEARANCE_M:
                return False
    return True


def stick_gap(stick: Pose2, x: float, y: float) -> float:
    """Return the distance of a position from the stick's two axes [m]."""
    local = stick.inverse() @ Pose2(x, y)
    along = min(max(local.x, 0.0), HANDLE_LENGTH_M)
    handle = math.hypot(local.x - along, local.y)
    bar_u = HANDLE_LENGTH_M - STICK_SECTION_M / 2
    across = min(max(local.y, 0.0), HOOK_LENGTH_M - STICK_SECTION_M / 2)
    hook = math.hypot(local.x - bar_u, local.y - across)
    return min(handle, hook)


def stick_discs(stick: Pose2) -> tuple[Disc, ...]:
    """Return discs that cover a lying stick."""
    half = STICK_SECTION_M / 2
    spacing = 0.05
    handle = [(i * spacing, 0.0) for i in range(round(HANDLE_LENGTH_M / spacing) + 1)]
    hook = [(HANDLE_LENGTH_M - half, v) for v in (0.05, 0.10, HOOK_LENGTH_M - half)]
    placed = [stick @ Pose2(u, v) for u, v in (*handle, *hook)]
    return tuple((pose.x, pose.y, half) for pose in placed)


def is_prepared(
    primitive: Primitive, stick: Pose2, cube: Pose2, kind: ObjectKind = CUBE
) -> bool:
    """Whether a stick lies so that a drag would take the cube along."""
    if kind.drag_m is None:
        return False
    u, v = _contact(primitive, kind.drag_m)
    u += _DIRECTION[primitive] * PREPARE_GAP_M
    local = stick.inverse() @ cube
    return abs(local.x - u) < 0.025 and abs(local.y - v) < 0.025
