"""Collision spheres of an arm against the table and obstacle capsules, for RMPflow."""

import math

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.motion.rmpflow import leaves

TABLE_RANGE_M = 0.10
"""Distance beyond which the table is ignored."""
OWN_BASE_RANGE_M = 0.06
"""Distance beyond which the arm's own base is ignored."""
_FIRST_WRIST_LINK = 4
_ROUNDING_M = 1e-9
"""Upper bound of rounding errors."""


@kernel
def add_collision_leaves(
    root: np.record,
    spheres: FloatArray,
    qd: FloatArray,
    obstacles: FloatArray,
    memory: tuple[FloatArray, FloatArray],
) -> None:
    """Add to the root the collision leaves of all spheres that are near an obstacle.

    Args:
        root: The record of a :class:`~lemma.motion.rmpflow.workspace.Workspace`, with
            up-to-date link frames.
        spheres: Centre [m], radius [m], link frame, 1 if the table is an obstacle:
            (n, 6).
        qd: Joint velocities, (6,) [rad/s].
        obstacles: Both ends, radius and range of capsules, (m, 8) [m].
        memory: Result of :func:`collision_memory` for spheres and obstacles.
    """
    centres, balls = memory
    near = _find_near(root, spheres, centres, balls)
    column = root.column
    for i in range(3):
        column[0, i] = root.frames[0, i, 3]
        column[0, 3 + i] = root.frames[1, i, 3]
    column[0, 6] = root.base_radius_m
    for s in range(spheres.shape[0]):
        radius, link = spheres[s, 3], int(spheres[s, 4])
        x, y, z = centres[s, 0], centres[s, 1], centres[s, 2]
        centre = (x, y, z)
        if spheres[s, 5] > 0.0 and z - radius < TABLE_RANGE_M:
            up = (0.0, 0.0, 1.0)
            _add_one(root, qd, link, centre, up, z - radius, TABLE_RANGE_M)
        if link >= _FIRST_WRIST_LINK and root.base_radius_m > 0.0:
            gap, away = capsule_distance(column, 0, centre)
            if gap - radius < OWN_BASE_RANGE_M:
                _add_one(root, qd, link, centre, away, gap - radius, OWN_BASE_RANGE_M)
        for k in range(near):
            o = int(balls[k, 4])
            dx, dy, dz = x - balls[o, 0], y - balls[o, 1], z - balls[o, 2]
            least = balls[o, 3] + radius
            if dx * dx + dy * dy + dz * dz > least * least:
                continue
            gap, away = capsule_distance(obstacles, o, centre)
            if gap - radius < obstacles[o, 7]:
                _add_one(root, qd, link, centre, away, gap - radius, obstacles[o, 7])


@kernel
def collision_memory(
    spheres: FloatArray, obstacles: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return scratch memory for :func:`add_collision_leaves`.

    Args:
        spheres: As there, (n, 6).
        obstacles: As there, (m, 8) [m].

    Returns:
        Memory for the centres of spheres in the world, (n, 3) [m], and bounding balls
        of the obstacles with their ranges, (m, 5): centre [m], radius [m], and memory
        for the index of a near obstacle.
    """
    balls = np.empty((obstacles.shape[0], 5))
    for o in range(obstacles.shape[0]):
        length = 0.0
        for i in range(3):
            balls[o, i] = 0.5 * (obstacles[o, i] + obstacles[o, 3 + i])
            length += (obstacles[o, i] - obstacles[o, 3 + i]) ** 2
        balls[o, 3] = 0.5 * math.sqrt(length) + obstacles[o, 6] + obstacles[o, 7]
        balls[o, 3] += _ROUNDING_M
    return np.empty((spheres.shape[0], 3)), balls


@kernel
def _find_near(
    root: np.record, spheres: FloatArray, centres: FloatArray, balls: FloatArray
) -> int:
    """Compute the spheres' centres, and the obstacles that are near their bounding box.

    Returns:
        The number of near obstacles; their indices are in the last column of ``balls``.
    """
    low, high = root.low, root.high
    low[:], high[:] = math.inf, -math.inf
    for s in range(spheres.shape[0]):
        f, radius = root.frames[int(spheres[s, 4])], spheres[s, 3]
        sx, sy, sz = spheres[s, 0], spheres[s, 1], spheres[s, 2]
        for i in range(3):
            value = f[i, 0] * sx + f[i, 1] * sy + f[i, 2] * sz + f[i, 3]
            centres[s, i] = value
            low[i] = min(low[i], value - radius)
            high[i] = max(high[i], value + radius)
    near = 0
    for o in range(balls.shape[0]):
        apart = False
        for i in range(3):
            reach = balls[o, 3]
            apart |= balls[o, i] < low[i] - reach or balls[o, i] > high[i] + reach
        if not apart:
            balls[near, 4] = o
            near += 1
    return near


@kernel
def capsule_distance(
    capsules: FloatArray, o: int, point: tuple[float, float, float]
) -> tuple[float, tuple[float, float, float]]:
    """Return a point's distance from a capsule [m], and the direction away from it.

    Args:
        capsules: Both ends and radius, (n, 7+) [m].
        o: Index of the capsule. Creating a view of its row would dominate the time.
        point: The point [m].
    """
    ax, ay, az = capsules[o, 0], capsules[o, 1], capsules[o, 2]
    abx, aby, abz = capsules[o, 3] - ax, capsules[o, 4] - ay, capsules[o, 5] - az
    x, y, z = point[0] - ax, point[1] - ay, point[2] - az
    length = abx * abx + aby * aby + abz * abz
    if length >= 1e-12:
        t = min(1.0, max(0.0, (abx * x + aby * y + abz * z) / length))
        x, y, z = x - t * abx, y - t * aby, z - t * abz
    gap = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / max(gap, 1e-9)
    return gap - capsules[o, 6], (x * scale, y * scale, z * scale)


@kernel
def _add_one(
    root: np.record,
    qd: FloatArray,
    link: int,
    centre: tuple[float, float, float],
    away: tuple[float, float, float],
    distance: float,
    radius: float,
) -> None:
    """Add the leaf of one sphere and one obstacle.

    Its task space is the distance. The Jacobian of the distance is the direction away
    from the obstacle times the Jacobian of the sphere's centre.
    """
    row = root.row
    rate = 0.0
    for j in range(link):
        f = root.frames[j]
        x, y, z = centre[0] - f[0, 3], centre[1] - f[1, 3], centre[2] - f[2, 3]
        row[j] = (
            away[0] * (f[1, 2] * z - f[2, 2] * y)
            + away[1] * (f[2, 2] * x - f[0, 2] * z)
            + away[2] * (f[0, 2] * y - f[1, 2] * x)
        )
        rate += row[j] * qd[j]
    acceleration, metric = leaves.collision(
        root.leaves.collision, distance, rate, radius
    )
    for i in range(link):
        root.force[i] += row[i] * metric * acceleration
        for j in range(i + 1):
            root.metric[i, j] += row[i] * metric * row[j]
