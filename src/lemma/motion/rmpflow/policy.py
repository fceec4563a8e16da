"""RMPflow: pulls the leaves back to the joints and computes one acceleration.

``qdd = (sum J^T M J)^-1 sum J^T M (xdd - Jdot qd)``, capped and integrated in substeps.
The result is a smooth joint reference for the servos. It depends on the arguments
alone: there is no clock, no simulator and no random number.

The kernels read and write one flat record, see
:class:`~lemma.motion.rmpflow.workspace.Workspace`.
"""

import math

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.motion.rmpflow import leaves
from lemma.motion.rmpflow.collision import add_collision_leaves, collision_memory
from lemma.robots.ur.kinematics import frames, point_jacobian

Triple = tuple[float, float, float]


@kernel
def integrate(
    record: np.ndarray,
    spheres: FloatArray,
    state: FloatArray,
    obstacles: FloatArray,
    step_s: float,
    substeps: int,
) -> None:
    """Advance the joint reference by semi-implicit Euler.

    As a safeguard beside the leaves, velocities are clipped to the motors' limits, and
    to values from which a joint can brake before its limit.

    Args:
        record: The record of a loaded workspace.
        spheres: Its spheres, (m, 6).
        state: Joint angles [rad] and velocities [rad/s], (2, 6); written.
        obstacles: Capsules (ax, ay, az, bx, by, bz, radius, range), (n, 8) [m]; beyond
            its range an obstacle is ignored.
        step_s: Length of a substep [s].
        substeps: Number of substeps.
    """
    root = record[0]
    acceleration, memory = root.acceleration, collision_memory(spheres, obstacles)
    for _ in range(substeps):
        accelerate(root, spheres, state, obstacles, memory, acceleration)
        for i in range(6):
            rate = state[1, i] + acceleration[i] * step_s
            end = root.upper[i] if rate > 0 else root.lower[i]
            brakeable = 2.0 * root.leaves.max_acceleration * abs(end - state[0, i])
            limit = min(
                root.velocity_limits[i] * root.leaves.velocity_cap.limit_fraction,
                math.sqrt(brakeable),
            )
            state[1, i] = min(limit, max(-limit, rate))
            state[0, i] += state[1, i] * step_s
            if state[0, i] < root.lower[i] or state[0, i] > root.upper[i]:
                state[0, i] = min(root.upper[i], max(root.lower[i], state[0, i]))
                state[1, i] = 0.0


@kernel
def accelerate(
    root: np.record,
    spheres: FloatArray,
    state: FloatArray,
    obstacles: FloatArray,
    memory: tuple[FloatArray, FloatArray],
    out: FloatArray,
) -> None:
    """Write the joint accelerations that combine all leaves to ``out``, (6,) [rad/s2].

    Args:
        root: The record of a loaded workspace.
        spheres: Its spheres, (m, 6).
        state: Joint angles [rad] and velocities [rad/s], (2, 6).
        obstacles: As in :func:`integrate`, (n, 8) [m].
        memory: Result of :func:`~.collision.collision_memory` for the obstacles.
        out: Written.
    """
    q, qd = state[0], state[1]
    root.metric[:] = 0.0
    root.force[:] = 0.0
    update_motion(root, q, qd)
    if root.goal.target_weight > 0.0:
        distance = _add_target_leaf(root, qd)
        _add_axis_leaf(root, distance)
    _add_posture_and_damping(root, q, qd)
    _add_joint_limits(root, q, qd)
    add_collision_leaves(root, spheres, qd, obstacles, memory)
    solve(root.metric, root.force, out)
    norm = 0.0
    for i in range(6):
        norm += out[i] * out[i]
    norm = math.sqrt(norm)
    if norm > root.leaves.max_acceleration:
        for i in range(6):
            out[i] *= root.leaves.max_acceleration / norm


@kernel
def update_motion(root: np.record, q: FloatArray, qd: FloatArray) -> None:
    """Compute link frames and their motion at zero joint acceleration (for Jdot qd)."""
    frames(root.dh, root.world_from_base, q, root.frames)
    f, w, wd, acc = root.frames, root.omega, root.omega_dot, root.origin_acceleration
    for i in range(6):
        zx, zy, zz = f[i, 0, 2], f[i, 1, 2], f[i, 2, 2]
        rate = qd[i]
        # A joint axis that rotates itself adds wd += w x (z qd).
        wd[i + 1, 0] = wd[i, 0] + rate * (w[i, 1] * zz - w[i, 2] * zy)
        wd[i + 1, 1] = wd[i, 1] + rate * (w[i, 2] * zx - w[i, 0] * zz)
        wd[i + 1, 2] = wd[i, 2] + rate * (w[i, 0] * zy - w[i, 1] * zx)
        w[i + 1, 0] = w[i, 0] + rate * zx
        w[i + 1, 1] = w[i, 1] + rate * zy
        w[i + 1, 2] = w[i, 2] + rate * zz
        rx = f[i + 1, 0, 3] - f[i, 0, 3]
        ry = f[i + 1, 1, 3] - f[i, 1, 3]
        rz = f[i + 1, 2, 3] - f[i, 2, 3]
        drift = point_drift(root, i + 1, rx, ry, rz)
        for k in range(3):
            acc[i + 1, k] = acc[i, k] + drift[k]


@kernel
def point_drift(root: np.record, link: int, rx: float, ry: float, rz: float) -> Triple:
    """Return the relative acceleration of the ends of r: wd x r + w x (w x r) [m/s2].

    Args:
        root: The record, with up-to-date motion of the links.
        link: Index of the link that r is fixed to.
        rx: World x of the vector r between two points of the link [m].
        ry: World y [m].
        rz: World z [m].
    """
    wx, wy, wz = root.omega[link, 0], root.omega[link, 1], root.omega[link, 2]
    wd = root.omega_dot[link]
    cx, cy, cz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    return (
        wd[1] * rz - wd[2] * ry + wy * cz - wz * cy,
        wd[2] * rx - wd[0] * rz + wz * cx - wx * cz,
        wd[0] * ry - wd[1] * rx + wx * cy - wy * cx,
    )


@kernel
def _pull_back(root: np.record) -> None:
    """Add J^T M J and J^T M a to the root, for the leaf in its scratch memory."""
    jacobian, weight, wanted = root.jacobian, root.weight, root.wanted
    for i in range(6):
        mx, my, mz = 0.0, 0.0, 0.0
        for k in range(3):
            mx += jacobian[k, i] * weight[k, 0]
            my += jacobian[k, i] * weight[k, 1]
            mz += jacobian[k, i] * weight[k, 2]
        root.force[i] += mx * wanted[0] + my * wanted[1] + mz * wanted[2]
        for j in range(i + 1):
            root.metric[i, j] += (
                mx * jacobian[0, j] + my * jacobian[1, j] + mz * jacobian[2, j]
            )


@kernel
def _add_target_leaf(root: np.record, qd: FloatArray) -> float:
    """Add the target leaf; return the distance to the target [m]."""
    f, goal, offset = root.frames[6], root.goal, root.tcp_offset_m
    point, error, velocity = root.point, root.error, root.velocity
    for i in range(3):
        point[i] = f[i, 3] + offset * f[i, 2]
        error[i] = goal.position[i] - point[i]
    point_jacobian(root.frames, 6, point, root.jacobian)
    for i in range(3):
        velocity[i] = 0.0
        for j in range(6):
            velocity[i] += root.jacobian[i, j] * qd[j]
    distance = leaves.target(
        root.leaves.target, error, velocity, root.wanted, root.weight
    )
    rx, ry, rz = offset * f[0, 2], offset * f[1, 2], offset * f[2, 2]
    drift = point_drift(root, 6, rx, ry, rz)
    for i in range(3):
        root.wanted[i] -= root.origin_acceleration[6, i] + drift[i]
        for j in range(3):
            root.weight[i, j] *= goal.target_weight
    _pull_back(root)
    return distance


@kernel
def _add_axis_leaf(root: np.record, distance: float) -> None:
    """Add the axis leaves of the gripper."""
    metric = leaves.axes(
        root.leaves.axis,
        root.frames[6],
        root.goal.rotation,
        root.omega[6],
        distance,
        root.wanted,
    )
    for i in range(3):
        root.wanted[i] -= root.omega_dot[6, i]
        for j in range(3):
            root.weight[i, j] = root.goal.target_weight * metric if i == j else 0.0
        for j in range(6):
            # Each joint turns the gripper about the joint's axis.
            root.jacobian[i, j] = root.frames[j, i, 2]
    _pull_back(root)


@kernel
def _add_posture_and_damping(root: np.record, q: FloatArray, qd: FloatArray) -> None:
    posture, damping = root.leaves.posture, root.leaves.damping
    error, speed = 0.0, 0.0
    for i in range(6):
        error += (root.goal.posture[i] - q[i]) ** 2
        speed += qd[i] ** 2
    error, speed = math.sqrt(error), math.sqrt(speed)
    cap = 1.0 if error < posture.cap_rad else posture.cap_rad / error
    weight = root.goal.posture_weight * posture.metric
    for i in range(6):
        pull = posture.gain * cap * (root.goal.posture[i] - q[i])
        root.metric[i, i] += weight + posture.inertia
        root.force[i] += weight * (pull - posture.damping * qd[i])
        root.metric[i, i] += damping.metric * speed + damping.inertia
        root.force[i] -= damping.metric * speed * damping.damping * speed * qd[i]


@kernel
def _add_joint_limits(root: np.record, q: FloatArray, qd: FloatArray) -> None:
    limit = root.leaves.joint_limit
    for i in range(6):
        acceleration, metric = leaves.velocity_cap(
            root.leaves.velocity_cap, qd[i], root.velocity_limits[i]
        )
        root.metric[i, i] += metric
        root.force[i] += metric * acceleration
        span = root.upper[i] - root.lower[i]
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            edge = root.lower[i] if side == 0 else root.upper[i]
            x = (sign * (q[i] - edge) - limit.buffer_rad) / span
            acceleration, metric = leaves.joint_limit(limit, x, sign * qd[i] / span)
            # Its task space is the normalised distance: dx/dq = sign / span.
            root.metric[i, i] += metric / (span * span)
            root.force[i] += sign * metric * acceleration / span


@kernel
def solve(metric: FloatArray, force: FloatArray, out: FloatArray) -> None:
    """Solve a 6 x 6 positive definite system by Cholesky.

    Args:
        metric: The matrix, (6, 6); only the lower triangle is used, and overwritten.
        force: (6,).
        out: The solution, (6,).
    """
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
