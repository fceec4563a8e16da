"""Where the stick must be to drag or push a cube: pure geometry of the plane.

Sampling asks whether a robot could do it, the expert asks how. Both get their answer
here, so that what is sampled as solvable is what the expert then does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lemma.core.poses import Pose2, wrap
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
from lemma.tasks.subtask import Primitive

LARGEST_HEADING_RAD = math.radians(100.0)
"""How far a stick that a robot shall pick up may point away from straight outward."""
PREPARE_GAP_M = 0.02
"""Between the stick and the cube before the drag: a cube turned by 45 degrees fits."""

_INNER_FACE_M = HANDLE_LENGTH_M - STICK_SECTION_M
_DIRECTION = {Primitive.HOOK: -1.0, Primitive.POKE: 1.0}
_STICK_CLEARANCE_M = STICK_SECTION_M / 2 + 0.012
_GRIP_MARGIN_M = 0.015
_END_MARGIN_M = 0.05
_GOOD_MARGIN_M = 0.10
_BEARINGS_RAD = tuple(
    math.radians(d) for d in (0, 8, -8, 16, -16, 24, -24, 32, -32, 42, -42, 54, -54)
)
MAX_DRAG_M = 0.26
"""A longer drag may lose the cube. It also keeps the tasks apart: what is pushed over
to the other robot is too far away to be dragged back."""
_LENGTHS_M = tuple(round(0.10 + 0.02 * i, 2) for i in range(9))

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


def stick_in_grasp(gripper: Pose2) -> Pose2:
    """Return the stick's pose when the gripper holds its handle."""
    return gripper @ Pose2(-GRASP_FROM_END_M, 0.0)


def find_drag(
    primitive: Primitive,
    robot: RobotPlacement,
    cube: Pose2,
    margin_at: Callable[[float, float], float],
    obstacles: Sequence[Disc],
    kind: ObjectKind = CUBE,
) -> Drag | None:
    """Find the best way for a robot to bring a cube where it is wanted.

    Args:
        primitive: ``HOOK`` (towards the robot) or ``POKE`` (away from it).
        robot: Who drags.
        cube: Where the cube is.
        margin_at: How far inside the wanted region a position is [m].
        obstacles: What the stick and the cube keep clear of.
        kind: What is dragged, if it is no cube.

    Returns:
        The drag with the best margin, among equals the shortest and straightest; None
        if there is no way, or the kind cannot be dragged.
    """
    if kind.drag_m is None:
        return None
    reach = reach_of(robot.arm)
    base = robot.base
    outward = math.atan2(cube.y - base.y, cube.x - base.x)
    found: list[Drag] = []
    for turn in _BEARINGS_RAD:
        bearing = outward + turn
        prepared = _gripper(primitive, cube, bearing, PREPARE_GAP_M, kind.drag_m)
        if reach.margin(base, prepared.x, prepared.y) < _GRIP_MARGIN_M:
            continue
        sign = _DIRECTION[primitive]
        cos, sin = sign * math.cos(bearing), sign * math.sin(bearing)
        for length in _LENGTHS_M:
            moved = Pose2(cube.x + length * cos, cube.y + length * sin, bearing)
            margin = margin_at(moved.x, moved.y)
            if margin < _END_MARGIN_M:
                continue
            end = _gripper(primitive, moved, bearing, 0.0, kind.drag_m)
            if reach.margin(base, end.x, end.y) < _GRIP_MARGIN_M:
                continue
            score = min(margin, _GOOD_MARGIN_M) - 0.15 * length - 0.03 * abs(turn)
            found.append(Drag(primitive, prepared, end, moved, score))
    found.sort(key=lambda drag: -drag.score)
    for drag in found:
        if _is_free(drag, cube, obstacles, kind.disc_m):
            return drag
    return None


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


def _is_free(drag: Drag, cube: Pose2, obstacles: Sequence[Disc], disc_m: float) -> bool:
    """Whether stick and cube meet nothing, where the stick is put and all along."""
    for i in range(6):
        t = i / 5
        grip = Pose2(
            drag.prepared.x + t * (drag.end.x - drag.prepared.x),
            drag.prepared.y + t * (drag.end.y - drag.prepared.y),
            drag.end.yaw,
        )
        x = cube.x + t * (drag.cube.x - cube.x)
        y = cube.y + t * (drag.cube.y - cube.y)
        stick = stick_in_grasp(grip)
        for ox, oy, radius in obstacles:
            if math.hypot(ox - x, oy - y) < radius + disc_m + 0.01:
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
