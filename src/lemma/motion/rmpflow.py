"""RMPflow: the leaves, pulled back to the joints and resolved into one acceleration.

``qdd = (sum J^T M J)^-1 sum J^T M (xdd - Jdot qd)``, capped and integrated in substeps.
The result is a smooth joint reference for the servos; nothing here reads the clock, the
simulator or a random number.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from lemma.core.poses import FloatArray
from lemma.motion import leaves
from lemma.motion.leaves import Leaves
from lemma.robots.kinematics import frames, point_jacobian


class ArmModel(NamedTuple):
    """What RMPflow knows about the arm that it moves."""

    dh: FloatArray
    """(6,) [m]."""
    world_from_base: FloatArray
    """(4, 4)."""
    tcp_offset_m: float
    """Tool centre point beyond the flange, along its z axis."""
    lower: FloatArray
    """Joint limits, (6,) [rad]."""
    upper: FloatArray
    velocity_limits: FloatArray
    """(6,) [rad/s]."""
    sphere_links: FloatArray
    """Link frame that each collision sphere is attached to, (n,)."""
    spheres: FloatArray
    """Centre in that frame and radius, (n, 4) [m]."""
    sphere_meets_table: FloatArray
    """1 where the table is an obstacle for the sphere, (n,)."""


class Goal(NamedTuple):
    """Where the arm shall go."""

    position: FloatArray
    """Of the tool centre point, (3,) [m]."""
    rotation: FloatArray
    """Of the gripper, (3, 3)."""
    posture: FloatArray
    """Joint angles to prefer, (6,) [rad]."""
    target_weight: float
    """1, or 0 to follow the posture alone."""
    posture_weight: float
    """1, or more where the posture is all there is to follow."""


class Root(NamedTuple):
    """The sums that the leaves are pulled back into, and scratch memory."""

    metric: FloatArray
    force: FloatArray
    frames: FloatArray
    omega: FloatArray
    omega_dot: FloatArray
    origin_acceleration: FloatArray
    jacobian: FloatArray


def make_root() -> Root:
    """Return scratch memory for one arm."""
    return Root(
        np.zeros((6, 6)),
        np.zeros(6),
        np.zeros((7, 4, 4)),
        np.zeros((7, 3)),
        np.zeros((7, 3)),
        np.zeros((7, 3)),
        np.zeros((3, 6)),
    )


@njit(cache=True)
def _update_motion(root: Root, arm: ArmModel, q: FloatArray, qd: FloatArray) -> None:
    """Compute link frames, and their motion if no joint accelerated (for Jdot qd)."""
    frames(arm.dh, arm.world_from_base, q, root.frames)
    f, w, wd, acc = root.frames, root.omega, root.omega_dot, root.origin_acceleration
    for i in range(6):
        zx, zy, zz = f[i, 0, 2], f[i, 1, 2], f[i, 2, 2]
        rate = qd[i]
        # Spinning about an axis that itself turns: wd += w x (z qd).
        wd[i + 1, 0] = wd[i, 0] + rate * (w[i, 1] * zz - w[i, 2] * zy)
        wd[i + 1, 1] = wd[i, 1] + rate * (w[i, 2] * zx - w[i, 0] * zz)
        wd[i + 1, 2] = wd[i, 2] + rate * (w[i, 0] * zy - w[i, 1] * zx)
        w[i + 1, 0] = w[i, 0] + rate * zx
        w[i + 1, 1] = w[i, 1] + rate * zy
        w[i + 1, 2] = w[i, 2] + rate * zz
        rx = f[i + 1, 0, 3] - f[i, 0, 3]
        ry = f[i + 1, 1, 3] - f[i, 1, 3]
        rz = f[i + 1, 2, 3] - f[i, 2, 3]
        ax, ay, az = _transport(wd[i + 1], w[i + 1], rx, ry, rz)
        acc[i + 1, 0] = acc[i, 0] + ax
        acc[i + 1, 1] = acc[i, 1] + ay
        acc[i + 1, 2] = acc[i, 2] + az


@njit(cache=True)
def _transport(
    wd: FloatArray, w: FloatArray, rx: float, ry: float, rz: float
) -> tuple[float, float, float]:
    """Return wd x r + w x (w x r)."""
    cx, cy, cz = w[1] * rz - w[2] * ry, w[2] * rx - w[0] * rz, w[0] * ry - w[1] * rx
    return (
        wd[1] * rz - wd[2] * ry + w[1] * cz - w[2] * cy,
        wd[2] * rx - wd[0] * rz + w[2] * cx - w[0] * cz,
        wd[0] * ry - wd[1] * rx + w[0] * cy - w[1] * cx,
    )


@njit(cache=True)
def _pull_back(
    root: Root,
    jacobian: FloatArray,
    metric: FloatArray,
    acceleration: FloatArray,
    first: int,
) -> None:
    """Add J^T M J and J^T M a to the root; columns before ``first`` joints only."""
    for i in range(first):
        mi = np.empty(3)
        for k in range(3):
            mi[k] = (
                jacobian[0, i] * metric[0, k]
                + jacobian[1, i] * metric[1, k]
                + jacobian[2, i] * metric[2, k]
            )
        root.force[i] += (
            mi[0] * acceleration[0] + mi[1] * acceleration[1] + mi[2] * acceleration[2]
        )
        for j in range(first):
            root.metric[i, j] += (
                mi[0] * jacobian[0, j] + mi[1] * jacobian[1, j] + mi[2] * jacobian[2, j]
            )


@njit(cache=True)
def _add_tool_leaves(
    root: Root, arm: ArmModel, goal: Goal, parameters: Leaves, qd: FloatArray
) -> None:
    f = root.frames[6]
    point = np.empty(3)
    error = np.empty(3)
    velocity = np.zeros(3)
    wanted = np.empty(3)
    metric = np.empty((3, 3))
    for i in range(3):
        point[i] = f[i, 3] + arm.tcp_offset_m * f[i, 2]
        error[i] = goal.position[i] - point[i]
    point_jacobian(root.frames, 6, point, root.jacobian)
    for i in range(3):
        for j in range(6):
            velocity[i] += root.jacobian[i, j] * qd[j]
    distance = leaves.target(parameters.target, error, velocity, wanted, metric)
    drift = _transport(
        root.omega_dot[6],
        root.omega[6],
        arm.tcp_offset_m * f[0, 2],
        arm.tcp_offset_m * f[1, 2],
        arm.tcp_offset_m * f[2, 2],
    )
    for i in range(3):
        wanted[i] -= root.origin_acceleration[6, i] + drift[i]
        for j in range(3):
            metric[i, j] *= goal.target_weight
    _pull_back(root, root.jacobian, metric, wanted, 6)
    leaf = parameters.axis
    weight = goal.target_weight * leaf.metric
    weight *= leaves.boost(leaf.boost, leaf.boost_sigma_m, distance)
    for axis in range(3):
        for j in range(6):
            zx, zy, zz = (
                root.frames[j, 0, 2],
                root.frames[j, 1, 2],
                root.frames[j, 2, 2],
            )
            root.jacobian[0, j] = zy * f[2, axis] - zz * f[1, axis]
            root.jacobian[1, j] = zz * f[0, axis] - zx * f[2, axis]
            root.jacobian[2, j] = zx * f[1, axis] - zy * f[0, axis]
        drift = _transport(
            root.omega_dot[6], root.omega[6], f[0, axis], f[1, axis], f[2, axis]
        )
        for i in range(3):
            rate = 0.0
            for j in range(6):
                rate += root.jacobian[i, j] * qd[j]
            wanted[i] = (
                leaf.gain * (goal.rotation[i, axis] - f[i, axis])
                - leaf.damping * rate
                - drift[i]
            )
            for k in range(3):
                metric[i, k] = weight if i == k else 0.0
        _pull_back(root, root.jacobian, metric, wanted, 6)


@njit(cache=True)
def _add_joint_leaves(
    root: Root,
    arm: ArmModel,
    goal: Goal,
    parameters: Leaves,
    q: FloatArray,
    qd: FloatArray,
) -> None:
    posture = parameters.posture
    norm = 0.0
    speed = 0.0
    for i in range(6):
        norm += (goal.posture[i] - q[i]) ** 2
        speed += qd[i] ** 2
    norm = math.sqrt(norm)
    speed = math.sqrt(speed)
    cap = 1.0 if norm < posture.cap_rad else posture.cap_rad / norm
    damping = parameters.damping
    limit = parameters.joint_limit
    for i in range(6):
        pull = posture.gain * cap * (goal.posture[i] - q[i]) - posture.damping * qd[i]
        weight = goal.posture_weight * posture.metric
        root.metric[i, i] += weight + posture.inertia
        root.force[i] += weight * pull
        root.metric[i, i] += damping.metric * speed + damping.inertia
        root.force[i] -= damping.metric * speed * damping.damping * speed * qd[i]
        acceleration, metric = leaves.velocity_cap(
            parameters.velocity_cap, qd[i], arm.velocity_limits[i]
        )
        root.metric[i, i] += metric
        root.force[i] += metric * acceleration
        span = arm.upper[i] - arm.lower[i]
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            edge = arm.lower[i] if side == 0 else arm.upper[i]
            x = (sign * (q[i] - edge) - limit.buffer_rad) / span
            acceleration, metric = leaves.joint_limit(limit, x, sign * qd[i] / span)
            # The leaf lives on the normalised distance: dx/dq = sign / span.
            root.metric[i, i] += metric / (span * span)
            root.force[i] += sign * metric * acceleration / span


@njit(cache=True)
def _add_collision_leaves(
    root: Root,
    arm: ArmModel,
    parameters: Leaves,
    qd: FloatArray,
    obstacles: FloatArray,
) -> None:
    centre = np.empty(3)
    normal = np.empty(3)
    for s in range(arm.spheres.shape[0]):
        link = int(arm.sphere_links[s])
        f = root.frames[link]
        local = arm.spheres[s]
        for i in range(3):
            centre[i] = (
                f[i, 0] * local[0] + f[i, 1] * local[1] + f[i, 2] * local[2] + f[i, 3]
            )
        have_jacobian = False
        for o in range(-1, obstacles.shape[0]):
            if o < 0:
                if arm.sphere_meets_table[s] == 0.0:
                    continue
                normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
                distance = centre[2] - local[3]
                radius = 0.10
            else:
                radius = obstacles[o, 7]
                distance = _distance(centre, obstacles[o], normal) - local[3]
            if distance >= radius:
                continue
            if not have_jacobian:
                point_jacobian(root.frames, link, centre, root.jacobian)
                have_jacobian = True
            _add_one_collision(root, parameters, qd, link, normal, distance, radius)


@njit(cache=True)
def _add_one_collision(  # noqa: PLR0913 - a kernel, kept flat for speed
    root: Root,
    parameters: Leaves,
    qd: FloatArray,
    link: int,
    normal: FloatArray,
    distance: float,
    radius: float,
) -> None:
    row = np.zeros(6)
    rate = 0.0
    for j in range(link):
        row[j] = (
            normal[0] * root.jacobian[0, j]
            + normal[1] * root.jacobian[1, j]
            + normal[2] * root.jacobian[2, j]
        )
        rate += row[j] * qd[j]
    acceleration, metric = leaves.collision(
        parameters.collision, distance, rate, radius
    )
    for i in range(link):
        root.force[i] += row[i] * metric * acceleration
        for j in range(link):
            root.metric[i, j] += row[i] * metric * row[j]


@njit(cache=True)
def _distance(centre: FloatArray, capsule: FloatArray, normal: FloatArray) -> float:
    """Return the distance of a point to a capsule; ``normal`` points away from it."""
    ab = np.empty(3)
    along = 0.0
    length = 0.0
    for i in range(3):
        ab[i] = capsule[3 + i] - capsule[i]
        along += ab[i] * (centre[i] - capsule[i])
        length += ab[i] * ab[i]
    t = 0.0 if length < 1e-12 else min(1.0, max(0.0, along / length))
    gap = 0.0
    for i in range(3):
        normal[i] = centre[i] - capsule[i] - t * ab[i]
        gap += normal[i] * normal[i]
    gap = math.sqrt(gap)
    for i in range(3):
        normal[i] /= max(gap, 1e-9)
    return gap - capsule[6]


@njit(cache=True)
def _solve(metric: FloatArray, force: FloatArray, out: FloatArray) -> None:
    """Solve the 6 x 6 positive definite system by Cholesky, destroying ``metric``."""
    for j in range(6):
        for k in range(j):
            metric[j, j] -= metric[j, k] * metric[j, k]
        metric[j, j] = math.sqrt(metric[j, j])
        for i in range(j + 1, 6):
            for k in range(j):
                metric[i, j] -= metric[i, k] * metric[j, k]
            metric[i, j] /= metric[j, j]
    for i in range(6):
        out[i] = force[i]
        for k in range(i):
            out[i] -= metric[i, k] * out[k]
        out[i] /= metric[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            out[i] -= metric[k, i] * out[k]
        out[i] /= metric[i, i]


@njit(cache=True)
def accelerate(
    root: Root,
    arm: ArmModel,
    goal: Goal,
    parameters: Leaves,
    state: FloatArray,
    obstacles: FloatArray,
    out: FloatArray,
) -> None:
    """Write the joint accelerations that all leaves agree on to ``out``, (6,).

    Args:
        root: Scratch memory.
        arm: The arm.
        goal: Where it shall go.
        parameters: The leaves.
        state: Joint angles and velocities, (2, 6).
        obstacles: Capsules (ax, ay, az, bx, by, bz, radius, range), (n, 8) [m]; beyond
            ``range`` an obstacle is not felt.
        out: Written, (6,) [rad/s2].
    """
    q, qd = state[0], state[1]
    root.metric[:] = 0.0
    root.force[:] = 0.0
    _update_motion(root, arm, q, qd)
    if goal.target_weight > 0.0:
        _add_tool_leaves(root, arm, goal, parameters, qd)
    _add_joint_leaves(root, arm, goal, parameters, q, qd)
    _add_collision_leaves(root, arm, parameters, qd, obstacles)
    _solve(root.metric, root.force, out)
    norm = 0.0
    for i in range(6):
        norm += out[i] * out[i]
    norm = math.sqrt(norm)
    if norm > parameters.max_acceleration:
        for i in range(6):
            out[i] *= parameters.max_acceleration / norm


@njit(cache=True)
def integrate(  # noqa: PLR0913 - a kernel, kept flat for speed
    root: Root,
    arm: ArmModel,
    goal: Goal,
    parameters: Leaves,
    state: FloatArray,
    obstacles: FloatArray,
    step_s: float,
    substeps: int,
) -> None:
    """Advance the joint reference ``state``, (2, 6), by ``substeps`` of ``step_s``.

    Semi-implicit Euler; velocities are clipped to the motors' limits as a last resort,
    where the velocity leaf has not already done it.
    """
    acceleration = np.empty(6)
    for _ in range(substeps):
        accelerate(root, arm, goal, parameters, state, obstacles, acceleration)
        for i in range(6):
            limit = arm.velocity_limits[i] * parameters.velocity_cap.limit_fraction
            rate = state[1, i] + acceleration[i] * step_s
            state[1, i] = min(limit, max(-limit, rate))
            state[0, i] += state[1, i] * step_s
            if state[0, i] < arm.lower[i] or state[0, i] > arm.upper[i]:
                state[0, i] = min(arm.upper[i], max(arm.lower[i], state[0, i]))
                state[1, i] = 0.0
