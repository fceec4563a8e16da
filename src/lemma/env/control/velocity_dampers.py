"""Velocity dampers, which limit approach speed by distance.

At every distance, two bodies can still stop in time (Faverjon and Tournassoud, 1987). A
command is projected onto the allowed motions, so sliding along the table stays
possible. The code is plain compiled loops, which give the same numbers on every
machine.

Few of the hundreds of pairs are near and fast enough to matter. The others are skipped
by bounds that hold while joint speeds change by no more than :data:`EXPECTED_RAD_S`. If
they change by more, all pairs are computed. The result is therefore bit-identical to
one without skipping.
"""

import math

import numpy as np

from lemma.core.errors import CapacityError
from lemma.core.kernels import borrowed, kernel
from lemma.core.poses import FloatArray
from lemma.env.control.guarded_arm import (
    CAPSULES,
    CLEARANCE_M,
    CORNERS,
    DECELERATION_M_S2,
    RANGE_M,
    ROUNDING,
    SELF_MARGIN_M,
    find_own,
    is_clear,
    measure_gaps,
    place_and_move,
)
from lemma.robots.collision_model import SELF_PAIRS, Triple, closest_points
from lemma.robots.gripper import TCP_OFFSET_M

EXPECTED_RAD_S = 0.15
"""Change of joint speeds (norm) up to which the bounds hold."""

_SLACK_M_S = 0.005
_SWEEPS = 12
_FIRST_ABOVE_TABLE = 2
_LAST_ABOVE_TABLE = 7
_FIRST_OF_HAND = 7
_HAND = 6
"""Index of the hand's link."""
_TOUCH_M_S = 0.25
"""Speed limit of a hand that touches an object or puts one down."""
_IN_HAND_M = 0.10
"""An object nearer to the tool centre point than this is being handled."""
# Pairs of parts of one arm that can collide.
_OWN_PAIRS = np.concatenate(
    [
        SELF_PAIRS,
        [
            (corner, inner)
            for corner in range(CAPSULES, CAPSULES + CORNERS)
            for inner in range(_FIRST_ABOVE_TABLE + 1)
        ],
    ]
)
_ANY_RAD_S = 1e6
"""A change of joint speeds for which no pair is skipped."""


@kernel
def most_rows(arms: int, objects: int) -> int:
    """Return the largest possible number of constraints.

    Args:
        arms: Capsules of the other arms.
        objects: Capsules of all objects.
    """
    table = 2 * (_LAST_ABOVE_TABLE - _FIRST_ABOVE_TABLE + 1) + CORNERS
    each = CORNERS + _FIRST_OF_HAND - _FIRST_ABOVE_TABLE
    pairs: int = _OWN_PAIRS.shape[0]
    return table + pairs + (CAPSULES - 1) * arms + each * objects


@kernel
def restrain(
    arm: np.record,
    obstacles: FloatArray,
    objects: FloatArray,
    held: FloatArray,
    rates: FloatArray,
) -> bool:
    """Change joint speeds in place, as little as needed to avoid collisions.

    Args:
        arm: The arm, links placed; see :data:`~lemma.env.control.guarded_arm.ARM`.
        obstacles: Capsules of the other arms, (m, 12); see
            :data:`~lemma.env.control.guarded_arm.ROW`.
        objects: Records of objects, (k, 12).
        held: Records of objects in the hand, (l, 12).
        rates: Joint speeds, (6,) [rad/s].

    Returns:
        Whether any speed changed.

    Raises:
        CapacityError: There are more constraints than :func:`most_rows` says.
    """
    place_and_move(arm, rates)
    most = most_rows(obstacles.shape[0], objects.shape[0] + held.shape[0])
    memory, wanted = np.empty((most, 7)), rates.copy()
    rows = borrowed(memory)
    changed = False
    for expected in (EXPECTED_RAD_S, _ANY_RAD_S):
        rates[:] = wanted
        count = _constrain(arm, obstacles, objects, held, expected, rows)
        changed, most_changed = _project(rows, count, rates, arm.speeds)
        if most_changed <= expected:
            break
    # Keep `memory` alive: Numba frees it when unused, and the rows are views of it.
    return changed and memory.size > 0


@kernel
def _constrain(
    arm: np.record,
    obstacles: FloatArray,
    objects: FloatArray,
    held: FloatArray,
    expected: float,
    rows: FloatArray,
) -> int:
    """Write all constraints that can be active; return their number."""
    measure_gaps(arm, expected)
    find_own(arm, expected)
    count = _add_table_rows(arm, expected, rows)
    count = _add_hand_rows(arm, objects, held, expected, rows, count)
    count = _add_self_rows(arm, expected, rows, count)
    count = _add_arm_rows(arm, obstacles, expected, rows, count)
    return _add_object_rows(arm, objects, expected, rows, count)


@kernel
def _add_table_rows(arm: np.record, expected: float, rows: FloatArray) -> int:
    """Keep the links clear of the table."""
    count = 0
    for i in range(_FIRST_ABOVE_TABLE, _LAST_ABOVE_TABLE + 1):
        safe, part = arm.gaps[i], arm.world[i]
        for end in range(2):
            x, y, z = part[3 * end], part[3 * end + 1], part[3 * end + 2]
            gap = z - part[6]
            if gap <= safe:
                found = gap, (x, y, z), (x, y, z - 1.0)
                count = _add_row(arm, (0, i), found, 0.0, expected, rows, count)
    return count


@kernel
def _add_hand_rows(
    arm: np.record,
    objects: FloatArray,
    held: FloatArray,
    expected: float,
    rows: FloatArray,
    count: int,
) -> int:
    """Limit the speed at which the hand touches objects or puts one down."""
    for k in range(CAPSULES, CAPSULES + CORNERS):
        safe, corner = arm.gaps[k], arm.world[k]
        x, y, z = corner[0], corner[1], corner[2]
        if z <= safe:
            found = z, (x, y, z), (x, y, z - 1.0)
            count = _add_row(arm, (0, k), found, 0.0, expected, rows, count)
        for m in range(objects.shape[0]):
            if not is_clear(arm.world, k, objects, m, safe):
                found = closest_points(corner, objects[m])
                count = _add_row(arm, (0, k), found, _TOUCH_M_S, expected, rows, count)
    for m in range(held.shape[0]):
        thing = held[m]
        below = thing[7] - max(thing[2], thing[5])
        for end in range(2):
            x, y, z = thing[3 * end], thing[3 * end + 1], thing[3 * end + 2]
            found = z - below, (x, y, z), (x, y, z - 1.0)
            # A held object has no known lever arm, so never skip its constraint.
            count = _add_row(
                arm, (0, CAPSULES), found, _TOUCH_M_S, _ANY_RAD_S, rows, count
            )
    return count


@kernel
def _add_self_rows(
    arm: np.record, expected: float, rows: FloatArray, count: int
) -> int:
    """Keep the parts of the arm apart."""
    for k in range(_OWN_PAIRS.shape[0]):
        outer, inner = _OWN_PAIRS[k, 0], _OWN_PAIRS[k, 1]
        if int(arm.own[outer]) >> inner & 1:
            link = int(arm.parts[inner, 7])
            gap, near, far = closest_points(arm.world[outer], arm.world[inner])
            found = gap - SELF_MARGIN_M, near, far
            count = _add_row(arm, (link, outer), found, 0.0, expected, rows, count)
    return count


@kernel
def _add_arm_rows(
    arm: np.record,
    obstacles: FloatArray,
    expected: float,
    rows: FloatArray,
    count: int,
) -> int:
    """Keep the arm clear of the others."""
    for i in range(1, CAPSULES):
        # Both arms may move, so each may use half of the distance.
        safe = 2.0 * arm.gaps[i]
        for j in range(obstacles.shape[0]):
            if not is_clear(arm.world, i, obstacles, j, safe):
                gap, near, far = closest_points(arm.world[i], obstacles[j])
                found = 0.5 * gap, near, far
                count = _add_row(arm, (0, i), found, 0.0, expected, rows, count)
    return count


@kernel
def _add_object_rows(
    arm: np.record, objects: FloatArray, expected: float, rows: FloatArray, count: int
) -> int:
    """Keep the arm without its hand clear of objects that are not in the hand."""
    tcp, hand = np.zeros(7), arm.placed[_HAND]
    for i in range(3):
        tcp[i] = tcp[3 + i] = hand[i, 3] + TCP_OFFSET_M * hand[i, 2]
    for m in range(objects.shape[0]):
        is_beside = False
        for i in range(_FIRST_ABOVE_TABLE, _FIRST_OF_HAND):
            if is_clear(arm.world, i, objects, m, arm.gaps[i]):
                continue
            thing = objects[m]
            if not is_beside and closest_points(tcp, thing)[0] + thing[6] < _IN_HAND_M:
                break
            is_beside = True
            found = closest_points(arm.world[i], thing)
            count = _add_row(arm, (0, i), found, 0.0, expected, rows, count)
    return count


@kernel
def _add_row(
    arm: np.record,
    bodies: tuple[int, int],
    found: tuple[float, Triple, Triple],
    least: float,
    expected: float,
    rows: FloatArray,
    count: int,
) -> int:
    """Add the constraint on the approach of a point of the arm to another point.

    Args:
        arm: The arm.
        bodies: A link, and a part beyond it; the joints between them change the
        distance.
        found: Gap between the surfaces, point of the arm, and the approached point [m].
        least: Approach that is always allowed [m/s].
        expected: Bound of the change of joint speeds [rad/s].
        rows: (n, 7): approach per joint speed [m], largest approach [m/s].
        count: Rows so far.

    Returns:
        Rows now.

    Raises:
        CapacityError: There is no room for another row.
    """
    gap, (x, y, z), far = found
    dx, dy, dz = far[0] - x, far[1] - y, far[2] - z
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    room = max(0.0, gap - CLEARANCE_M)
    limit = max(math.sqrt(2.0 * DECELERATION_M_S2 * room), least)
    first, last = bodies[0], int(arm.parts[bodies[1], 7])
    t, u = arm.twists[last], arm.twists[first]
    wx, wy, wz = t[0] - u[0], t[1] - u[1], t[2] - u[2]
    approach = (
        dx * (t[3] - u[3] + wy * z - wz * y)
        + dy * (t[4] - u[4] + wz * x - wx * z)
        + dz * (t[5] - u[5] + wx * y - wy * x)
    )
    more = arm.parts[bodies[1], 8] * expected + ROUNDING
    if gap > RANGE_M or length < 1e-9 or approach + more * length < limit * length:
        return count
    if count >= rows.shape[0]:
        raise CapacityError("There are more velocity dampers than most_rows() says.")
    _write_row(
        arm,
        (first, last),
        (x, y, z),
        (dx / length, dy / length, dz / length),
        rows,
        count,
    )
    rows[count, 6] = limit
    return count + 1


@kernel
def _write_row(
    arm: np.record,
    links: tuple[int, int],
    near: Triple,
    direction: Triple,
    rows: FloatArray,
    r: int,
) -> None:
    """Write the Jacobian row of a point of a link along a direction [m]."""
    dx, dy, dz = direction
    for j in range(6):
        rows[r, j] = 0.0
        if links[0] <= j < links[1]:
            f = arm.placed[j]
            x, y, z = near[0] - f[0, 3], near[1] - f[1, 3], near[2] - f[2, 3]
            rows[r, j] = (
                dx * (f[1, 2] * z - f[2, 2] * y)
                + dy * (f[2, 2] * x - f[0, 2] * z)
                + dz * (f[0, 2] * y - f[1, 2] * x)
            )


@kernel
def _project(
    rows: FloatArray, count: int, rates: FloatArray, limits: FloatArray
) -> tuple[bool, float]:
    """Project joint speeds onto the constraints of the first rows, one by one.

    Returns:
        Whether they changed, and the norm of the largest change on the way [rad/s].
    """
    changed, farthest = False, 0.0
    before = rates.copy()
    for _ in range(_SWEEPS):
        clean = True
        for r in range(count):
            approach = 0.0
            for j in range(6):
                approach += rows[r, j] * rates[j]
            if approach <= rows[r, 6]:
                continue
            norm = 0.0
            for j in range(6):
                norm += rows[r, j] * rows[r, j]
            if norm > 1e-12:
                changed, clean = True, False
                step = (approach - rows[r, 6]) / norm
                away = 0.0
                for j in range(6):
                    rates[j] -= step * rows[r, j]
                    away += (rates[j] - before[j]) ** 2
                farthest = max(farthest, away)
        if clean:
            break
    if not changed:
        return False, 0.0
    scale = 1.0
    for j in range(6):
        if abs(rates[j]) * scale > limits[j]:
            scale = limits[j] / abs(rates[j])
    for r in range(count):
        approach = 0.0
        for j in range(6):
            approach += rows[r, j] * rates[j]
        most = rows[r, 6] + _SLACK_M_S
        if approach * scale > most:
            scale = most / approach
    for j in range(6):
        rates[j] *= scale
    return True, math.sqrt(farthest)
