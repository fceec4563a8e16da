"""Velocity dampers: the nearer two things come, the slower they may approach.

At every distance they can still stop in time (Faverjon and Tournassoud, 1987). What
remains of a command is a nearby motion that obeys; sliding along the table stays
possible. Plain loops, compiled: the same numbers on every machine.
"""

import math

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.robots.collision_model import SELF_PAIRS, closest_points, place_capsules
from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGER_WIDTH_M,
    FINGERTIP_BEYOND_TCP_M,
    PALM_BEYOND_FLANGE_M,
    TCP_OFFSET_M,
)

CLEARANCE_M = 0.003
"""Distance that is kept; fingertips grasp a stick 6 mm above the table."""
DECELERATION_M_S2 = 2.0
"""How hard an approach can be braked by any arm in any posture."""

_RANGE_M = 0.8
_SLACK_M_S = 0.005
_SWEEPS = 12
_MOST_ROWS = 256
_FIRST_ABOVE_TABLE = 2
_LAST_ABOVE_TABLE = 7
_FIRST_OF_HAND = 7
# Corners of the fingers, wide open, and of the palm, in the frame of the flange [m].
_CORNERS = np.array(
    [
        (x * side, y * across, z)
        for x, y, z in (
            (
                FINGER_WIDTH_M / 2,
                FINGER_OPENING_M / 2 + FINGER_THICKNESS_M,
                TCP_OFFSET_M + FINGERTIP_BEYOND_TCP_M,
            ),
            (0.030, 0.056, PALM_BEYOND_FLANGE_M),
        )
        for side in (-1.0, 1.0)
        for across in (-1.0, 1.0)
    ]
)
_TOUCH_M_S = 0.25
"""How fast a hand may touch an object, and put one down."""
_IN_HAND_M = 0.10
"""What is nearer to the tool centre point than this is being handled."""
_SELF_MARGIN_M = 0.007
"""How much thicker the housings are than the capsules that stand for them."""


@kernel
def restrain(
    placed: FloatArray,
    capsules: FloatArray,
    obstacles: FloatArray,
    objects: FloatArray,
    held: FloatArray,
    rates: FloatArray,
    limits: FloatArray,
) -> bool:
    """Change joint speeds as little as it takes to keep clear, in place.

    Args:
        placed: World from link frames, (7, 4, 4).
        capsules: Of the arm, in link frames, and their links, (n, 8) [m].
        obstacles: Other arms: capsules in the world, (m, 7) [m].
        objects: The same for objects, and the height of their tops, (k, 8) [m].
        held: The same for what the hand holds, (l, 8) [m].
        rates: Joint speeds, (6,) [rad/s].
        limits: Largest joint speeds, (6,) [rad/s].

    Returns:
        Whether anything had to be changed.
    """
    world = np.empty((capsules.shape[0], 7))
    place_capsules(placed, capsules[:, 7], capsules[:, :7], world)
    rows = np.empty((_MOST_ROWS, 7))
    corners = np.zeros((_CORNERS.shape[0], 7))
    for k in range(_CORNERS.shape[0]):
        for i in range(3):
            corners[k, i] = placed[6, i, 3]
            for j in range(3):
                corners[k, i] += placed[6, i, j] * _CORNERS[k, j]
            corners[k, 3 + i] = corners[k, i]
    count = _add_table_rows(placed, capsules, world, rows)
    count = _add_hand_rows(placed, corners, objects, held, rows, count)
    count = _add_self_rows(placed, capsules, world, corners, rows, count)
    near, far = np.empty(3), np.empty(3)
    for i in range(1, world.shape[0]):
        for j in range(obstacles.shape[0]):
            # Both may move: each may use half of the distance.
            gap = 0.5 * closest_points(world[i], obstacles[j], near, far)
            links = (0, int(capsules[i, 7]))
            count = _add_row(placed, links, near, far, gap, rows, count)
    count = _add_object_rows(placed, capsules, world, objects, rows, count)
    return _project(rows[:count], rates, limits)


@kernel
def _add_table_rows(
    placed: FloatArray, capsules: FloatArray, world: FloatArray, rows: FloatArray
) -> int:
    """Keep the links clear of the table."""
    count = 0
    near, far = np.empty(3), np.empty(3)
    for i in range(_FIRST_ABOVE_TABLE, _LAST_ABOVE_TABLE + 1):
        for end in range(2):
            near[:] = world[i, 3 * end : 3 * end + 3]
            far[:] = near
            far[2] = near[2] - 1.0
            links = (0, int(capsules[i, 7]))
            gap = near[2] - world[i, 6]
            count = _add_row(placed, links, near, far, gap, rows, count)
    return count


@kernel
def _add_hand_rows(
    placed: FloatArray,
    corners: FloatArray,
    objects: FloatArray,
    held: FloatArray,
    rows: FloatArray,
    count: int,
) -> int:
    """Let the hand touch objects gently, and put down gently what it holds."""
    near, far = np.empty(3), np.empty(3)
    for k in range(corners.shape[0]):
        near[:] = corners[k, :3]
        far[:] = near
        far[2] = near[2] - 1.0
        count = _add_row(placed, (0, 6), near, far, near[2], rows, count)
        for m in range(objects.shape[0]):
            gap = closest_points(corners[k], objects[m], near, far)
            count = _add_soft_row(placed, near, far, gap, rows, count)
    for m in range(held.shape[0]):
        for end in range(2):
            near[:] = held[m, 3 * end : 3 * end + 3]
            far[:] = near
            far[2] = near[2] - 1.0
            half = held[m, 7] - max(held[m, 2], held[m, 5])
            gap = near[2] - half
            count = _add_soft_row(placed, near, far, gap, rows, count)
    return count


@kernel
def _add_self_rows(
    placed: FloatArray,
    capsules: FloatArray,
    world: FloatArray,
    corners: FloatArray,
    rows: FloatArray,
    count: int,
) -> int:
    """Keep the arm clear of itself."""
    near, far = np.empty(3), np.empty(3)
    for k in range(SELF_PAIRS.shape[0]):
        i, j = SELF_PAIRS[k, 0], SELF_PAIRS[k, 1]
        gap = closest_points(world[i], world[j], near, far) - _SELF_MARGIN_M
        links = (int(capsules[j, 7]), int(capsules[i, 7]))
        count = _add_row(placed, links, near, far, gap, rows, count)
    for k in range(corners.shape[0]):
        for j in range(_FIRST_ABOVE_TABLE + 1):
            gap = closest_points(corners[k], world[j], near, far) - _SELF_MARGIN_M
            links = (int(capsules[j, 7]), 6)
            count = _add_row(placed, links, near, far, gap, rows, count)
    return count


@kernel
def _add_object_rows(
    placed: FloatArray,
    capsules: FloatArray,
    world: FloatArray,
    objects: FloatArray,
    rows: FloatArray,
    count: int,
) -> int:
    """Keep what is not the hand clear of objects that are not in it."""
    near, far = np.empty(3), np.empty(3)
    tcp = np.zeros(7)
    for i in range(3):
        tcp[i] = placed[6, i, 3] + TCP_OFFSET_M * placed[6, i, 2]
        tcp[3 + i] = tcp[i]
    for m in range(objects.shape[0]):
        if closest_points(tcp, objects[m], near, far) + objects[m, 6] < _IN_HAND_M:
            continue
        for i in range(_FIRST_ABOVE_TABLE, _FIRST_OF_HAND):
            gap = closest_points(world[i], objects[m], near, far)
            links = (0, int(capsules[i, 7]))
            count = _add_row(placed, links, near, far, gap, rows, count)
    return count


@kernel
def _add_row(
    placed: FloatArray,
    links: tuple[int, int],
    near: FloatArray,
    far: FloatArray,
    gap: float,
    rows: FloatArray,
    count: int,
) -> int:
    """Add how joints bring a point of the arm nearer to another, and how fast they may.

    Args:
        placed: World from link frames.
        links: Joints between these two links change the distance.
        near: Point of the arm [m].
        far: The point that it approaches [m].
        gap: Distance of the surfaces [m].
        rows: (n, 7): approach per joint speed [m], largest approach [m/s].
        count: Rows so far.

    Returns:
        Rows now.
    """
    if gap > _RANGE_M or count >= rows.shape[0]:
        return count
    dx, dy, dz = far[0] - near[0], far[1] - near[1], far[2] - near[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length < 1e-9:
        return count
    dx, dy, dz = dx / length, dy / length, dz / length
    for j in range(6):
        rows[count, j] = 0.0
        if links[0] <= j < links[1]:
            f = placed[j]
            x, y, z = near[0] - f[0, 3], near[1] - f[1, 3], near[2] - f[2, 3]
            rows[count, j] = (
                dx * (f[1, 2] * z - f[2, 2] * y)
                + dy * (f[2, 2] * x - f[0, 2] * z)
                + dz * (f[0, 2] * y - f[1, 2] * x)
            )
    room = max(0.0, gap - CLEARANCE_M)
    rows[count, 6] = math.sqrt(2.0 * DECELERATION_M_S2 * room)
    return count + 1


@kernel
def _add_soft_row(
    placed: FloatArray,
    near: FloatArray,
    far: FloatArray,
    gap: float,
    rows: FloatArray,
    count: int,
) -> int:
    """Add a row for a point of the hand that may touch, gently."""
    after = _add_row(placed, (0, 6), near, far, gap, rows, count)
    if after > count:
        rows[count, 6] = max(rows[count, 6], _TOUCH_M_S)
    return after


@kernel
def _project(rows: FloatArray, rates: FloatArray, limits: FloatArray) -> bool:
    """Project joint speeds onto what every row allows; return whether they changed."""
    changed = False
    for _ in range(_SWEEPS):
        clean = True
        for r in range(rows.shape[0]):
            approach, norm = 0.0, 0.0
            for j in range(6):
                approach += rows[r, j] * rates[j]
                norm += rows[r, j] * rows[r, j]
            if approach > rows[r, 6] and norm > 1e-12:
                changed, clean = True, False
                step = (approach - rows[r, 6]) / norm
                for j in range(6):
                    rates[j] -= step * rows[r, j]
        if clean:
            break
    if not changed:
        return False
    scale = 1.0
    for j in range(6):
        if abs(rates[j]) * scale > limits[j]:
            scale = limits[j] / abs(rates[j])
    for r in range(rows.shape[0]):
        approach = 0.0
        for j in range(6):
            approach += rows[r, j] * rates[j]
        most = rows[r, 6] + _SLACK_M_S
        if approach * scale > most:
            scale = most / approach
    for j in range(6):
        rates[j] *= scale
    return True
