"""Poses of the stick that drag or push a cube: planar geometry.

Sampling uses this module to check whether a robot can drag a cube, and the expert to
plan the drag. So the expert finds a drag wherever sampling found one.
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
"""Largest angle between a stick that a robot picks up and the outward direction."""
PREPARE_GAP_M = 0.02
"""Gap between stick and cube before the drag; a cube turned by 45 degrees fits."""

_INNER_FACE_M = HANDLE_LENGTH_M - STICK_SECTION_M
_DIRECTION = {Primitive.HOOK: -1.0, Primitive.POKE: 1.0}
_STICK_CLEARANCE_M = STICK_SECTION_M / 2 + 0.012
HAND_CLEARANCE_M = FINGER_CENTER_M + FINGER_DISC_M
"""Clearance around a gripper that opens to grasp or release the stick."""
LARGEST_TURN_RAD = math.radians(150.0)
"""Largest rotation of the carried stick relative to the bearing from the robot's base.
With more, the last joint would turn it the other way, through the arm."""
_GRIP_MARGIN_M = 0.015
_END_MARGIN_M = 0.05
_GOOD_MARGIN_M = 0.10
_BEARINGS_RAD = tuple(
    math.radians(d) for d in (0, 8, -8, 16, -16, 24, -24, 32, -32, 42, -42, 54, -54)
)
_LENGTHS_M = tuple(round(0.10 + 0.02 * i, 2) for i in range(20))
MIN_DRAG_M, MAX_DRAG_M = _LENGTHS_M[0], _LENGTHS_M[-1]
"""Shortest and longest planned drag. Positions that no robot could reach are 0.35 to
0.42 m outside of the reachable set."""
_HOLD_MARGIN_M = 0.02
_LEAST_WITHDRAWAL_M = 0.03
_MOST_WITHDRAWAL_M = 0.15
_EDGE_M = 0.03
"""Smallest distance of a dragged cube's centre from the table's edges."""

Disc = tuple[float, float, float]
"""Obstacle in the plane: x, y, radius [m]."""


@dataclass(frozen=True, slots=True)
class Drag:
    """One way to move a cube with the stick."""

    primitive: Primitive
    """``hook`` or ``poke``."""
    prepared: Pose2
    """World from gripper when the stick is put down next to the cube."""
    end: Pose2
    """World from gripper at the end of the drag."""
    left: Pose2
    """World from gripper when the stick is released, withdrawn from the cube."""
    cube: Pose2
    """World from cube after the drag."""
    score: float


def grasp_on_stick(stick: Pose2) -> Pose2:
    """Return world from gripper at the grasp of a lying stick.

    Args:
        stick: World from stick.
    """
    return stick @ Pose2(GRASP_FROM_END_M, 0.0)


def heading_from(base: Pose2, stick: Pose2) -> float:
    """Return the angle between a stick and the ray from a base to its grasp [rad].

    The angle is in [0, pi]. A stick that points back at the base would hit the arm that
    lifts it.

    Args:
        base: World from base.
        stick: World from stick.
    """
    grasp = grasp_on_stick(stick)
    outward = math.atan2(grasp.y - base.y, grasp.x - base.x)
    return abs(wrap(stick.yaw - outward))


def is_turned_too_far(base: Pose2, pick: Pose2, place: Pose2) -> bool:
    """Return whether a robot that carries the stick would turn it through its arm.

    Args:
        base: World from base.
        pick: World from gripper at the grasp, with the yaw of the stick.
        place: World from gripper at the release.
    """
    headings = [
        wrap(grip.yaw - math.atan2(grip.y - base.y, grip.x - base.x))
        for grip in (pick, place)
    ]
    return abs(headings[1] - headings[0]) > LARGEST_TURN_RAD


def stick_in_grasp(gripper: Pose2) -> Pose2:
    """Return world from stick for a gripper that holds its handle.

    Args:
        gripper: World from gripper.
    """
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
    """Find the best drag that brings a cube into a robot's reach.

    Args:
        primitive: ``HOOK`` (towards the robot) or ``POKE`` (away from it).
        robot: The robot that drags.
        receiver: The robot that must reach the cube afterwards.
        cube: World from cube.
        obstacles: Discs that the stick and the cube must avoid.
        kind: Kind of the dragged object, if it is no cube.
        gap_m: The gap in the table, into which a dragged cube would fall; None without
            one.

    Returns:
        The drag that ends with the largest reach margin of the receiver, among equal
        ones the shortest and straightest; None if there is none, or the kind cannot be
        dragged. Two drags at equal angles on either side of the receiver's base have
        equal margins, so rounding errors decide between them. Scores are not rounded,
        because that would change recorded episodes. The existence of a drag, on which
        sampling depends, is not affected.
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
    """Yield the drags in one direction that both robots' reach allows."""
    hooking = primitive is Primitive.HOOK
    reach, base = reach_of(robot.arm), robot.base
    wanted, there = reach_of(receiver.arm), receiver.base
    # A hook pulls towards the robot's own base, a poke pushes towards the receiver's.
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
    """Return world from gripper at the release of the stick after a drag.

    A hook is pushed out slightly and a head is drawn back, so that fingers fit around
    the cube and the robot can pick up the stick again.

    Args:
        primitive: ``HOOK`` or ``POKE``.
        robot: The robot that drags.
        end: World from gripper at the end of the drag, with the yaw of the stick.
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
    """Return x, y of a dragged cube of given half width in the stick's frame [m].

    It touches the hook in the middle of its free length, or the head in the middle of
    its outer face.
    """
    if primitive is Primitive.HOOK:
        across = 0.5 * (HOOK_LENGTH_M - STICK_SECTION_M) + STICK_SECTION_M / 2
        return _INNER_FACE_M - half_m, across
    return HANDLE_LENGTH_M + half_m, 0.5 * HOOK_LENGTH_M - STICK_SECTION_M / 2


def _gripper(
    primitive: Primitive, cube: Pose2, bearing: float, gap_m: float, half_m: float
) -> Pose2:
    """Return world from gripper with the stick ``gap_m`` away from the cube."""
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
    """Return whether stick and cube avoid obstacles and the cube stays on the table.

    The check samples six poses. Between two of them an object may be closer, mostly
    beside the end of the hook: 10 of 6,594 drags for 800 frozen instances pass one by
    less than 5 mm. More samples would change recorded episodes.
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
    """Return the distance of a position from the nearer of the stick's two axes [m]."""
    local = stick.inverse() @ Pose2(x, y)
    along = min(max(local.x, 0.0), HANDLE_LENGTH_M)
    handle = math.hypot(local.x - along, local.y)
    bar_u = HANDLE_LENGTH_M - STICK_SECTION_M / 2
    across = min(max(local.y, 0.0), HOOK_LENGTH_M - STICK_SECTION_M / 2)
    hook = math.hypot(local.x - bar_u, local.y - across)
    return min(handle, hook)


def stick_discs(stick: Pose2) -> tuple[Disc, ...]:
    """Return discs that cover a stick at a pose, each (x, y, radius) [m]."""
    half = STICK_SECTION_M / 2
    spacing = 0.05
    handle = [(i * spacing, 0.0) for i in range(round(HANDLE_LENGTH_M / spacing) + 1)]
    hook = [(HANDLE_LENGTH_M - half, v) for v in (0.05, 0.10, HOOK_LENGTH_M - half)]
    placed = [stick @ Pose2(u, v) for u, v in (*handle, *hook)]
    return tuple((pose.x, pose.y, half) for pose in placed)


def is_prepared(
    primitive: Primitive, stick: Pose2, cube: Pose2, kind: ObjectKind = CUBE
) -> bool:
    """Return whether a lying stick is prepared to drag an object.

    Args:
        primitive: ``HOOK`` or ``POKE``.
        stick: World from stick.
        cube: World from object.
        kind: Kind of the object.
    """
    if kind.drag_m is None:
        return False
    u, v = _contact(primitive, kind.drag_m)
    u += _DIRECTION[primitive] * PREPARE_GAP_M
    local = stick.inverse() @ cube
    return abs(local.x - u) < 0.025 and abs(local.y - v) < 0.025
