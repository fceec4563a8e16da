"""One flat record per arm, for the compiled kernels of controllers.

The records of all arms enter Numba as a single pointer, so calls are cheap.

The kernels compute cheap upper bounds of how fast parts of an arm approach other
things. The distance of two capsules is at least that of their bounding spheres, and no
point of a rigid part is faster than the faster of its two ends.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.collision_model import envelope_of, place_capsules
from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGER_WIDTH_M,
    FINGERTIP_BEYOND_TCP_M,
    PALM_BEYOND_FLANGE_M,
    TCP_OFFSET_M,
)
from lemma.robots.ur.arms import ArmSpec

SPEED_FRACTION = 0.95
"""Fraction of a joint's velocity limit that bounds the references."""
CAPSULES = 10
"""Capsules of one arm, see :class:`~lemma.robots.collision_model.Envelope`."""
CORNERS = 8
"""Number of corners of the fingers, wide open, and of the palm."""
INNER = (0, 1, 2, 4)
"""Parts near the base that are checked against outer parts of the same arm."""
SELF_MARGIN_M = 0.007
"""How much wider the housings are than the capsules that model them."""
ROW = 12
"""Length of a capsule's row, in the world: both ends and the radius; the range of
influence of an obstacle, or the height of an object's top; and center and radius of a
bounding sphere, see :func:`enclose` [m]."""
CLEARANCE_M = 0.003
"""Minimum distance; fingertips grasp a stick 6 mm above the table."""
DECELERATION_M_S2 = 2.0
"""Deceleration of an approach that any arm can reach in any posture."""
RANGE_M = 0.8
"""Pairs that are further apart than this are ignored."""
ROUNDING = 1e-9
"""Upper bound of the rounding errors in this module, in any unit."""
_PARTS = CAPSULES + CORNERS

ARM = np.dtype(
    [
        # Constants of the arm.
        ("dh", np.float64, 6),
        ("world_from_base", np.float64, (4, 4)),
        # Capsules, then corners: ends and radius in the frame of a link, the link, and
        # a bound of how far a joint speed of norm 1 moves them.
        ("parts", np.float64, (_PARTS, 9)),
        ("levers", np.float64, _PARTS),
        ("radii", np.float64, _PARTS),
        ("speeds", np.float64, 6),
        ("range", np.float64, 6),
        ("efforts", np.float64, 6),
        ("lag_s", np.float64),
        # Its indices in the arrays of the simulation.
        ("qpos", np.int64),
        ("dof", np.int64),
        ("ctrl", np.int64),
        ("gripper_ctrl", np.int64),
        ("fingers", np.int64, 2),
        # How many objects are beside the hand and in it.
        ("beside", np.int64),
        ("inside", np.int64),
        # Poses of its links, and their twists: angular velocity, and linear velocity at
        # the origin of the world.
        ("placed", np.float64, (7, 4, 4)),
        ("twists", np.float64, (7, 6)),
        # Its parts in the world; then their ends and the twists of their links,
        # transposed: one column per part.
        ("world", np.float64, (_PARTS, 12)),
        ("ends", np.float64, (6, _PARTS)),
        ("part_twists", np.float64, (6, _PARTS)),
        # Distance from the table within which each part can still stop.
        ("gaps", np.float64, _PARTS),
        # For each outer part, a bit mask of the inner parts that it may approach too
        # fast.
        ("own", np.float64, _PARTS),
    ]
)


def arm_records(arms: Sequence[ArmMotion]) -> NDArray[np.void]:
    """Return the records of arms of one scene, (n,)."""
    records = np.zeros(len(arms), ARM)
    for row, arm in zip(records, arms, strict=True):
        robot, spec = arm.robot, arm.robot.arm
        row["dh"] = spec.dh
        row["world_from_base"] = robot.world_from_base
        row["parts"] = _parts(spec)
        row["levers"], row["radii"] = row["parts"][:, 8], row["parts"][:, 6]
        row["speeds"] = SPEED_FRACTION * np.array(spec.velocity_limits)
        row["range"] = spec.joint_range
        row["efforts"] = spec.effort_limits
        row["lag_s"] = spec.lag_s
        row["qpos"], row["dof"] = robot.qpos.start, robot.dof.start
        row["ctrl"], row["gripper_ctrl"] = robot.ctrl.start, robot.gripper_ctrl
        row["fingers"] = robot.finger_qpos
    return records


def _parts(spec: ArmSpec) -> FloatArray:
    """Return capsules and corners: ends, radius, link and lever arm, (n, 9)."""
    envelope = envelope_of(spec.name)
    rows = np.zeros((_PARTS, 9))
    rows[:CAPSULES, :7] = envelope.capsules
    rows[:CAPSULES, 7] = envelope.capsule_links
    corners = _corners()
    rows[CAPSULES:, :3] = rows[CAPSULES:, 3:6] = corners
    rows[CAPSULES:, 7] = 6.0
    for row in rows:
        # An upper bound of the distance from an axis: the sum of the links between.
        span = max(math.hypot(*row[:3]), math.hypot(*row[3:6]))
        levers = []
        for length in np.abs(spec.dh[: int(row[7])])[::-1]:
            span += float(length)
            levers.append(span)
        row[8] = math.hypot(*levers)
    return rows


def _corners() -> list[tuple[float, float, float]]:
    """Return corners in the frame of the flange [m]."""
    return [
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


@kernel
def place_and_move(arm: np.record, rates: FloatArray) -> None:
    """Write parts in the world with their bounding spheres, and the twists of links."""
    place_capsules(arm.placed, arm.parts[:, 7], arm.parts, arm.world)
    twists = arm.twists
    twists[0] = 0.0
    for j in range(6):
        f = arm.placed[j]
        zx, zy, zz = f[0, 2] * rates[j], f[1, 2] * rates[j], f[2, 2] * rates[j]
        x, y, z = f[0, 3], f[1, 3], f[2, 3]
        twists[j + 1, 0] = twists[j, 0] + zx
        twists[j + 1, 1] = twists[j, 1] + zy
        twists[j + 1, 2] = twists[j, 2] + zz
        twists[j + 1, 3] = twists[j, 3] + y * zz - z * zy
        twists[j + 1, 4] = twists[j, 4] + z * zx - x * zz
        twists[j + 1, 5] = twists[j, 5] + x * zy - y * zx
    for i in range(arm.world.shape[0]):
        enclose(arm.world[i])
        link = int(arm.parts[i, 7])
        for k in range(6):
            arm.ends[k, i] = arm.world[i, k]
            arm.part_twists[k, i] = twists[link, k]


@kernel
def enclose(row: FloatArray) -> None:
    """Write the bounding sphere of a capsule to its row; see :data:`ROW`."""
    length = 0.0
    for k in range(3):
        row[8 + k] = 0.5 * (row[k] + row[3 + k])
        length += (row[k] - row[3 + k]) ** 2
    row[11] = 0.5 * math.sqrt(length) + row[6]


@kernel
def measure_gaps(arm: np.record, expected: float) -> None:
    """Write the stopping distance of each part to ``arm.gaps``.

    The distances hold while joint speeds change by a norm of at most ``expected``
    [rad/s]. Parts brake at :data:`DECELERATION_M_S2`.
    """
    ends, twists, levers, gaps = arm.ends, arm.part_twists, arm.levers, arm.gaps
    # Loop over columns, so that the compiler can vectorize over parts.
    for i in range(gaps.shape[0]):
        wx, wy, wz = twists[0, i], twists[1, i], twists[2, i]
        tx, ty, tz = twists[3, i], twists[4, i], twists[5, i]
        x, y, z = ends[0, i], ends[1, i], ends[2, i]
        vx, vy = tx + wy * z - wz * y, ty + wz * x - wx * z
        vz = tz + wx * y - wy * x
        first = vx * vx + vy * vy + vz * vz
        x, y, z = ends[3, i], ends[4, i], ends[5, i]
        vx, vy = tx + wy * z - wz * y, ty + wz * x - wx * z
        vz = tz + wx * y - wy * x
        second = vx * vx + vy * vy + vz * vz
        # No point between the ends of a rigid body is faster than both ends.
        fastest = math.sqrt(first if first > second else second)
        pace = fastest + levers[i] * expected
        gap = pace * pace / (2.0 * DECELERATION_M_S2) + CLEARANCE_M
        gaps[i] = (gap if gap < RANGE_M else RANGE_M) + ROUNDING


@kernel
def find_own(arm: np.record, expected: float) -> None:
    """Write the pairs of parts of the arm that may approach too fast to ``arm.own``.

    This is the full computation of a constraint, including :func:`.segment_points`, but
    without branches, so that the compiler can vectorize it. Most pairs are not too
    fast. The tolerances exceed the rounding errors.

    Args:
        arm: The arm, its parts placed and moving.
        expected: See :func:`measure_gaps`.
    """
    ends, twists, levers, radii = arm.ends, arm.part_twists, arm.levers, arm.radii
    own = arm.own
    own[:] = 0.0
    for inner in INNER:
        u, bit = arm.twists[int(arm.parts[inner, 7])], float(1 << inner)
        u0, u1, u2, u3, u4, u5 = u[0], u[1], u[2], u[3], u[4], u[5]
        px, py, pz = ends[0, inner], ends[1, inner], ends[2, inner]
        bx, by, bz = ends[3, inner] - px, ends[4, inner] - py, ends[5, inner] - pz
        bb, thick = bx * bx + by * by + bz * bz, radii[inner] + SELF_MARGIN_M
        point = bb <= 1e-12
        # Sixteen parts: four times the vector width.
        for k in range(own.shape[0] - 2):
            i = k + 2
            qx, qy, qz = ends[0, i], ends[1, i], ends[2, i]
            ax, ay, az = ends[3, i] - qx, ends[4, i] - qy, ends[5, i] - qz
            rx, ry, rz = qx - px, qy - py, qz - pz
            aa, ab = ax * ax + ay * ay + az * az, ax * bx + ay * by + az * bz
            ar, br = ax * rx + ay * ry + az * rz, bx * rx + by * ry + bz * rz
            denominator, length = aa * bb - ab * ab, aa if aa > 1e-12 else 1.0
            s = (ab * br - ar * bb) / denominator
            s = s if s > 0.0 else 0.0
            s = s if s < 1.0 else 1.0
            s = s if denominator > 1e-12 * aa * bb else 0.0
            t = (ab * s + br) / bb
            end = ((ab - ar) if t > 1.0 else -ar) / length
            end = end if end > 0.0 else 0.0
            end = end if end < 1.0 else 1.0
            s = end if t < 0.0 or t > 1.0 else s
            t = t if t > 0.0 else 0.0
            t = t if t < 1.0 else 1.0
            x, y, z = qx + s * ax, qy + s * ay, qz + s * az
            dx, dy, dz = px + t * bx - x, py + t * by - y, pz + t * bz - z
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            wx, wy, wz = twists[0, i] - u0, twists[1, i] - u1, twists[2, i] - u2
            vx = twists[3, i] - u3 + wy * z - wz * y
            vy = twists[4, i] - u4 + wz * x - wx * z
            vz = twists[5, i] - u5 + wx * y - wy * x
            pace = dx * vx + dy * vy + dz * vz
            pace += (levers[i] * expected + 2.0 * ROUNDING) * distance + ROUNDING
            gap = distance - thick - radii[i] - ROUNDING
            room = gap - CLEARANCE_M
            limit = math.sqrt(2.0 * DECELERATION_M_S2 * (room if room > 0.0 else 0.0))
            near = gap <= RANGE_M and pace >= limit * distance
            own[i] += bit if near or point else 0.0


@kernel
def is_clear(a: FloatArray, i: int, b: FloatArray, j: int, gap: float) -> bool:
    """Return True if two capsules are certainly further apart than a gap.

    Args:
        a: Capsules, (n, 12); see :data:`ROW`.
        i: Row in ``a``. Views of rows would take longer than the comparison.
        b: Other capsules, (m, 12).
        j: Row in ``b``.
        gap: Distance of the surfaces [m].
    """
    x, y, z = a[i, 8] - b[j, 8], a[i, 9] - b[j, 9], a[i, 10] - b[j, 10]
    least = gap + a[i, 11] + b[j, 11]
    clear: bool = x * x + y * y + z * z > least * least
    return clear
