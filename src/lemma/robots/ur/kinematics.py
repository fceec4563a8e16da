"""Forward, differential and closed-form inverse kinematics of UR arms.

Standard Denavit-Hartenberg frames, as published by Universal Robots:
``T_i = RotZ(q_i) TransZ(d_i) TransX(a_i) RotX(alpha_i)`` with
``a = (0, -a2, -a3, 0, 0, 0)``, ``d = (d1, 0, 0, d4, d5, d6)`` and
``alpha = (pi/2, 0, 0, pi/2, -pi/2, 0)``. Frame 0 is the base, frame 6 the flange.

The parameter ``dh`` is always ``(d1, a2, a3, d4, d5, d6)`` [m]. All functions are Numba
kernels with explicit loops, because results of BLAS differ between CPUs in the last
bits.
"""

import math

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray

_COS_ALPHA = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
_SIN_ALPHA = np.array([1.0, 0.0, 0.0, 1.0, -1.0, 0.0])

# Below this |sin q5| the last two wrist axes are parallel and q6 is free.
_WRIST_SINGULAR = 1e-9


@kernel
def multiply(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write the product of two homogeneous transforms, each (4, 4), to ``out``."""
    for i in range(3):
        for j in range(4):
            value = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
            out[i, j] = value + a[i, 3] if j == 3 else value
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@kernel
def invert(a: FloatArray, out: FloatArray) -> None:
    """Write the inverse of a homogeneous transform, (4, 4), to ``out``."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[j, i]
    for i in range(3):
        out[i, 3] = -(out[i, 0] * a[0, 3] + out[i, 1] * a[1, 3] + out[i, 2] * a[2, 3])
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@kernel
def link_transform(dh: FloatArray, index: int, angle: float, out: FloatArray) -> None:
    """Write frame ``index`` from frame ``index + 1`` to ``out``.

    Args:
        dh: The arm, (6,) [m].
        index: Index of the joint, from 0.
        angle: Joint angle [rad].
        out: (4, 4) [m].
    """
    ct, st = math.cos(angle), math.sin(angle)
    ca, sa = _COS_ALPHA[index], _SIN_ALPHA[index]
    a = 0.0
    d = 0.0
    if index == 0:
        d = dh[0]
    elif index == 1 or index == 2:
        a = -dh[index]
    else:
        d = dh[index]
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = ct, -st * ca, st * sa, a * ct
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = st, ct * ca, -ct * sa, a * st
    out[2, 0], out[2, 1], out[2, 2], out[2, 3] = 0.0, sa, ca, d
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@kernel
def frames(dh: FloatArray, base: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """Write all seven link frames to ``out``.

    Args:
        dh: The arm, (6,) [m].
        base: World from base, (4, 4) [m].
        q: Joint angles, (6,) [rad].
        out: World from link frames 0 to 6, (7, 4, 4) [m].
    """
    out[0] = base
    for i in range(6):
        _place_link(dh, i, q[i], out[i], out[i + 1])


@kernel
def _place_link(
    dh: FloatArray, index: int, angle: float, before: FloatArray, out: FloatArray
) -> None:
    """Write the product of ``before`` and a link transform; skip the zeros."""
    ct, st = math.cos(angle), math.sin(angle)
    ca, sa = _COS_ALPHA[index], _SIN_ALPHA[index]
    bends = index == 1 or index == 2
    a, d = (-dh[index], 0.0) if bends else (0.0, dh[index])
    for i in range(3):
        x, y, z = before[i, 0], before[i, 1], before[i, 2]
        out[i, 0] = x * ct + y * st
        out[i, 1] = x * (-st * ca) + y * (ct * ca) + z * sa
        out[i, 2] = x * (st * sa) + y * (-ct * sa) + z * ca
        out[i, 3] = x * (a * ct) + y * (a * st) + z * d + before[i, 3]
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@kernel
def forward(dh: FloatArray, q: FloatArray) -> FloatArray:
    """Return base from flange, (4, 4) [m], at joint angles ``q`` (6,) [rad]."""
    all_frames: FloatArray = np.empty((7, 4, 4))
    frames(dh, np.eye(4), q, all_frames)
    flange: FloatArray = all_frames[6]
    return flange


@kernel
def point_jacobian(
    all_frames: FloatArray, links: int, point: FloatArray, out: FloatArray
) -> None:
    """Write the translational Jacobian of a point to ``out``.

    Args:
        all_frames: World from link frames, (7, 4, 4) [m].
        links: Index of the frame that the point is attached to, which is also the
            number of joints that move it.
        point: The point in the world frame, (3,) [m].
        out: (3, 6) [m/rad]; columns of joints that do not move the point are zero.
    """
    for j in range(6):
        if j >= links:
            out[0, j] = out[1, j] = out[2, j] = 0.0
            continue
        rx = point[0] - all_frames[j, 0, 3]
        ry = point[1] - all_frames[j, 1, 3]
        rz = point[2] - all_frames[j, 2, 3]
        zx, zy, zz = all_frames[j, 0, 2], all_frames[j, 1, 2], all_frames[j, 2, 2]
        out[0, j] = zy * rz - zz * ry
        out[1, j] = zz * rx - zx * rz
        out[2, j] = zx * ry - zy * rx


@kernel
def inverse(dh: FloatArray, flange: FloatArray) -> FloatArray:
    """Return all joint angles that put the flange at a pose, ignoring joint limits.

    The wrist centre gives two shoulder angles, the tool axis two wrist angles, and the
    law of cosines two elbow angles (Hawkins, *Analytic Inverse Kinematics for the
    Universal Robots*, 2013).

    Args:
        dh: The arm, (6,) [m].
        flange: Base from flange, (4, 4) [m].

    Returns:
        Joint angles in [-pi, pi), (n, 6) [rad], with n from 0 to 8. If the wrist is
        singular, joint 6 is set to zero and solutions that coincide are repeated.
    """
    solutions = np.empty((8, 6))
    count = 0
    d4, d6 = dh[3], dh[5]
    wrist_x = flange[0, 3] - d6 * flange[0, 2]
    wrist_y = flange[1, 3] - d6 * flange[1, 2]
    radius = math.hypot(wrist_x, wrist_y)
    if radius < abs(d4):
        return solutions[:0].copy()
    heading = math.atan2(wrist_y, wrist_x)
    offset = math.acos(d4 / radius)
    for shoulder in range(2):
        q1 = heading + (offset if shoulder == 0 else -offset) + math.pi / 2
        s1, c1 = math.sin(q1), math.cos(q1)
        cos_q5 = (flange[0, 3] * s1 - flange[1, 3] * c1 - d4) / d6
        if abs(cos_q5) > 1.0 + 1e-12:
            continue
        cos_q5 = min(1.0, max(-1.0, cos_q5))
        for flip in range(2):
            q5 = math.acos(cos_q5) if flip == 0 else -math.acos(cos_q5)
            q6 = 0.0
            if abs(math.sin(q5)) > _WRIST_SINGULAR:
                sign = 1.0 if q5 > 0 else -1.0
                q6 = math.atan2(
                    sign * (-flange[0, 1] * s1 + flange[1, 1] * c1),
                    sign * (flange[0, 0] * s1 - flange[1, 0] * c1),
                )
            count = _add_elbows(dh, flange, (q1, q5, q6), solutions, count)
    for i in range(count):
        for j in range(6):
            turns = math.floor((solutions[i, j] + math.pi) / (2.0 * math.pi))
            solutions[i, j] -= 2.0 * math.pi * turns
    return solutions[:count].copy()


@kernel
def _add_elbows(
    dh: FloatArray,
    flange: FloatArray,
    known: tuple[float, float, float],
    solutions: FloatArray,
    count: int,
) -> int:
    """Append the solutions of joints 2 to 4, given joints 1, 5 and 6.

    Returns:
        The new number of solutions: two more, or the same if the wrist is out of reach.
    """
    q1, q5, q6 = known
    a2, a3, d4 = dh[1], dh[2], dh[3]
    link = np.empty((4, 4))
    inverted = np.empty((4, 4))
    product = np.empty((4, 4))
    # The product of the transforms of joints 2 to 4: inverse(T1) flange inverse(T5 T6).
    wrist = np.empty((4, 4))
    link_transform(dh, 0, q1, link)
    invert(link, inverted)
    multiply(inverted, flange, wrist)
    link_transform(dh, 5, q6, link)
    invert(link, inverted)
    multiply(wrist, inverted, product)
    link_transform(dh, 4, q5, link)
    invert(link, inverted)
    multiply(product, inverted, wrist)
    # The elbow triangle lies in the plane of frame 1; frame 4's y axis is normal.
    px = wrist[0, 3] - d4 * wrist[0, 1]
    py = wrist[1, 3] - d4 * wrist[1, 1]
    cos_q3 = (px * px + py * py - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
    if abs(cos_q3) > 1.0:
        return count
    q234 = math.atan2(wrist[1, 0], wrist[0, 0])
    for elbow in range(2):
        q3 = math.acos(cos_q3) if elbow == 0 else -math.acos(cos_q3)
        q2 = math.atan2(-py, -px) - math.atan2(
            a3 * math.sin(q3), a2 + a3 * math.cos(q3)
        )
        solutions[count, 0] = q1
        solutions[count, 1] = q2
        solutions[count, 2] = q3
        solutions[count, 3] = q234 - q2 - q3
        solutions[count, 4] = q5
        solutions[count, 5] = q6
        count += 1
    return count


@kernel
def top_down(x: float, y: float, z: float, yaw: float) -> FloatArray:
    """Return world from gripper, (4, 4) [m], for a gripper that points straight down.

    Args:
        x: World x of the tool centre point [m].
        y: World y [m].
        z: World z [m].
        yaw: Direction of the gripper's x axis [rad]; the fingers close along y.
    """
    pose = np.zeros((4, 4))
    c, s = math.cos(yaw), math.sin(yaw)
    pose[0, 0], pose[0, 1], pose[0, 3] = c, s, x
    pose[1, 0], pose[1, 1], pose[1, 3] = s, -c, y
    pose[2, 2], pose[2, 3] = -1.0, z
    pose[3, 3] = 1.0
    return pose
