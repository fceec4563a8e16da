"""Simplified collision geometry of an arm: capsules and spheres.

As an obstacle of other arms, an arm is a set of capsules along its links. For its own
motion around obstacles it is a set of spheres on its outer links. Both are given in
link frames, so that one forward kinematics places them.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.robots.gripper import FINGERTIP_BEYOND_TCP_M, TCP_OFFSET_M
from lemma.robots.ur.build import ARMS

Triple = tuple[float, float, float]

_FINGER_HALF_SPAN_M = 0.055
_FINGER_RADIUS_M = 0.018


@dataclass(frozen=True)
class Envelope:
    """Capsules and spheres of one arm type."""

    capsule_links: FloatArray
    """Link frame of each capsule, (n,)."""
    capsules: FloatArray
    """Both ends of the axis in that frame, then the radius, (n, 7) [m]."""
    sphere_links: FloatArray
    """Link frame of each sphere, (m,)."""
    spheres: FloatArray
    """Centre in that frame, then the radius, (m, 4) [m]."""
    sphere_meets_table: FloatArray
    """1 where the table is an obstacle, 0 for the spheres of the gripper, (m,)."""


@lru_cache
def envelope_of(arm_name: str) -> Envelope:
    """Return the envelope of an arm type.

    Raises:
        UnknownNameError: No such arm.
    """
    arm = ARMS[arm_name]
    side = arm.shoulder_offset
    forearm_side = side + arm.elbow_offset
    tip = TCP_OFFSET_M + FINGERTIP_BEYOND_TCP_M - _FINGER_RADIUS_M
    capsules = (
        (0, (0, 0, 0), (0, 0, arm.d1), arm.shoulder_radius),
        (1, (0, 0, 0), (0, 0, side), arm.shoulder_radius),
        (2, (arm.a2, 0, side), (0, 0, side), arm.elbow_radius),
        (2, (0, 0, side), (0, 0, forearm_side), arm.elbow_radius),
        (3, (arm.a3, 0, forearm_side), (0, 0, forearm_side), arm.elbow_radius),
        (3, (0, 0, forearm_side), (0, 0, arm.d4), arm.wrist_radius),
        (4, (0, 0, 0), (0, 0, arm.d5), arm.wrist_radius),
        (6, (0, 0, -arm.d6), (0, 0, 0.05), 0.06),
        (6, (0, 0.03, 0.06), (0, 0.03, tip), 0.04),
        (6, (0, -0.03, 0.06), (0, -0.03, tip), 0.04),
    )
    spheres = (
        (2, (0.5 * arm.a2, 0, side), arm.upper_tube_radius),
        (2, (0, 0, side), arm.elbow_radius * 1.1),
        (2, (0, 0, forearm_side), arm.elbow_radius * 1.1),
        (3, (0.67 * arm.a3, 0, forearm_side), arm.forearm_tube_radius * 1.1),
        (3, (0.33 * arm.a3, 0, forearm_side), arm.forearm_tube_radius * 1.1),
        (3, (0, 0, forearm_side), arm.wrist_radius * 1.2),
        (4, (0, 0, 0), arm.wrist_radius * 1.2),
        (4, (0, 0, arm.d5), arm.wrist_radius * 1.2),
        (6, (0, 0.03, 0.05), 0.05),
        (6, (0, -0.03, 0.05), 0.05),
        (6, (0, _FINGER_HALF_SPAN_M, tip), _FINGER_RADIUS_M),
        (6, (0, -_FINGER_HALF_SPAN_M, tip), _FINGER_RADIUS_M),
    )
    at_work = 4
    return Envelope(
        np.array([float(link) for link, *_ in capsules]),
        np.array([[*a, *b, radius] for _, a, b, radius in capsules]),
        np.array([float(link) for link, *_ in spheres]),
        np.array([[*centre, radius] for _, centre, radius in spheres]),
        np.array([1.0] * (len(spheres) - at_work) + [0.0] * at_work),
    )


def sweep_radius_m(arm_name: str) -> float:
    """Return the radius around the base that an arm's shoulder sweeps [m].

    The housings of the shoulder turn with the base, and are lower than a gripper that
    holds a cube on the table. So no object may stand inside this circle.

    Raises:
        UnknownNameError: No such arm.
    """
    arm = ARMS[arm_name]
    return arm.shoulder_offset + 2.0 * arm.shoulder_radius


@kernel
def place_capsules(
    all_frames: FloatArray, links: FloatArray, capsules: FloatArray, out: FloatArray
) -> None:
    """Transform capsules to world coordinates.

    Args:
        all_frames: World from link frames, (7, 4, 4) [m].
        links: Link frame of each capsule, (n,).
        capsules: Both ends and radius in link frames, (n, 7) [m].
        out: Both ends and radius in the world frame, (n, 7) or wider [m]; written.
    """
    for k in range(capsules.shape[0]):
        f = all_frames[int(links[k])]
        for end in range(2):
            for i in range(3):
                value = f[i, 3]
                for j in range(3):
                    value += f[i, j] * capsules[k, 3 * end + j]
                out[k, 3 * end + i] = value
        out[k, 6] = capsules[k, 6]


@kernel
def segment_points(a: FloatArray, b: FloatArray) -> tuple[float, Triple, Triple]:
    """Find the closest points of two segments.

    Ericson, *Real-Time Collision Detection*, section 5.1.9.

    Args:
        a: Both ends of a segment, (6+,) [m].
        b: The same of another segment.

    Returns:
        Their distance, the point on ``a`` and the point on ``b`` [m].
    """
    ax, ay, az = a[3] - a[0], a[4] - a[1], a[5] - a[2]
    bx, by, bz = b[3] - b[0], b[4] - b[1], b[5] - b[2]
    rx, ry, rz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    aa = ax * ax + ay * ay + az * az
    bb = bx * bx + by * by + bz * bz
    br = bx * rx + by * ry + bz * rz
    s = t = 0.0
    if aa <= 1e-12:
        if bb > 1e-12:
            t = min(1.0, max(0.0, br / bb))
    elif bb <= 1e-12:
        s = min(1.0, max(0.0, -(ax * rx + ay * ry + az * rz) / aa))
    else:
        ab = ax * bx + ay * by + az * bz
        ar = ax * rx + ay * ry + az * rz
        denominator = aa * bb - ab * ab
        # If the segments are parallel, any s is valid.
        if denominator > 1e-12 * aa * bb:
            s = min(1.0, max(0.0, (ab * br - ar * bb) / denominator))
        t = (ab * s + br) / bb
        if t < 0.0:
            t, s = 0.0, min(1.0, max(0.0, -ar / aa))
        elif t > 1.0:
            t, s = 1.0, min(1.0, max(0.0, (ab - ar) / aa))
    near = (a[0] + s * ax, a[1] + s * ay, a[2] + s * az)
    far = (b[0] + t * bx, b[1] + t * by, b[2] + t * bz)
    x, y, z = near[0] - far[0], near[1] - far[1], near[2] - far[2]
    return math.sqrt(x * x + y * y + z * z), near, far


@kernel
def segment_distance(a: FloatArray, b: FloatArray) -> float:
    """Return the distance between two segments, (6+,) each [m]."""
    distance: float = segment_points(a, b)[0]
    return distance


@kernel
def closest_points(a: FloatArray, b: FloatArray) -> tuple[float, Triple, Triple]:
    """Find the closest points of the axes of two capsules.

    Args:
        a: Ends and radius, (7+,) [m].
        b: The same.

    Returns:
        The gap between their surfaces, the point on the axis of ``a`` and the point on
        the axis of ``b`` [m]. The gap is negative if the capsules overlap.
    """
    distance, near, far = segment_points(a, b)
    return distance - a[6] - b[6], near, far


# Pairs of capsules of one arm that can come close: outer links and inner links.
SELF_PAIRS = np.array(
    [
        [outer, inner]
        for outer, inners in (
            (4, (0,)),
            (5, (0, 1)),
            (6, (0, 1, 2)),
            (7, (0, 1, 2, 4)),
            (8, (0, 1, 2, 4)),
            (9, (0, 1, 2, 4)),
        )
        for inner in inners
    ]
)


@kernel
def self_clearance(placed: FloatArray) -> float:
    """Return the smallest gap between links of one arm that can collide [m].

    Args:
        placed: Capsules of the arm in one frame, (n, 7) [m].
    """
    least = np.inf
    for k in range(SELF_PAIRS.shape[0]):
        a = placed[SELF_PAIRS[k, 0]]
        b = placed[SELF_PAIRS[k, 1]]
        least = min(least, segment_distance(a, b) - a[6] - b[6])
    return least


@kernel
def obstacle_clearance(placed: FloatArray, obstacles: FloatArray) -> float:
    """Return the smallest gap between an arm and obstacle capsules [m].

    Args:
        placed: Capsules of the arm, (n, 7) [m]; the first, on the base, is ignored.
        obstacles: Capsules in the same frame, (m, 7) or wider [m].
    """
    least = np.inf
    for i in range(1, placed.shape[0]):
        for j in range(obstacles.shape[0]):
            gap = segment_distance(placed[i], obstacles[j])
            least = min(least, gap - placed[i, 6] - obstacles[j, 6])
    return least


@kernel
def table_clearance(placed: FloatArray) -> float:
    """Return the smallest gap of upper arm, forearm and wrist 1 to the table [m].

    Args:
        placed: Capsules of one arm in the world frame, (n, 7) [m].
    """
    least = np.inf
    for k in range(2, 7):
        least = min(least, min(placed[k, 2], placed[k, 5]) - placed[k, 6])
    return least
