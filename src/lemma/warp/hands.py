"""Forward and inverse kinematics and pose control of many arms, in torch.

Poses are 12 numbers: the position of a tool center point in the world [m], then its
rotation matrix, row by row.
"""

import math

import torch
from torch import Tensor

from lemma.env.control.pose_controllers import HIGHEST_M, LEASH_STEPS, LOWEST_M
from lemma.policies.control.hand_steps import LOWEST_M as LOWEST_TIP_M
from lemma.policies.control.hand_steps import Arms
from lemma.robots.gripper import TCP_OFFSET_M

STEP_M, TURN_RAD = 0.05, 0.25
"""Largest step along an axis and about it, as on the CPU."""
_EPS = 1e-6


def hand_poses(q: Tensor, base: Tensor, arms: Arms) -> Tensor:
    """Return the poses of tool center points in the world, (..., robots, 12).

    As :func:`lemma.robots.ur.kinematics.forward`. The axes of joints 2, 3 and 4 are
    parallel, so the arm is in one vertical plane up to its first wrist.

    Args:
        q: Joint angles, (..., robots, 6) [rad].
        base: x, y and yaw of each base, (..., robots, 3) [m, rad].
        arms: The robots' arms.

    Returns:
        Position [m], then the rotation matrix, row by row.
    """
    d1, a2, a3, d4, d5, d6 = arms.dh.unbind(-1)
    first, upper = base[..., 2] + q[..., 0], q[..., 1]
    fore = upper + q[..., 2]
    wrist = fore + q[..., 3]
    angles = torch.stack([first, upper, fore, wrist, q[..., 4], q[..., 5]], -1)
    c1, c2, c3, c4, c5, c6 = torch.cos(angles).unbind(-1)
    s1, s2, s3, s4, s5, s6 = torch.sin(angles).unbind(-1)
    zero = torch.zeros_like(c1)
    # Unit vectors away from the base in the arm's plane, and normal to that plane.
    away = torch.stack([c1, s1, zero], -1)
    across = torch.stack([s1, -c1, zero], -1)

    def in_plane(out: Tensor, up: Tensor) -> Tensor:
        flat = out[..., None] * away
        return torch.cat([flat[..., :2], up[..., None]], -1)

    x4, z4 = in_plane(c4, s4), in_plane(s4, -c4)
    x5 = x4 * c5[..., None] + across * s5[..., None]
    z5 = across * c5[..., None] - x4 * s5[..., None]
    x6 = x5 * c6[..., None] - z4 * s6[..., None]
    y6 = -x5 * s6[..., None] - z4 * c6[..., None]
    height = d1 - a2 * s2 - a3 * s3
    at = in_plane(-a2 * c2 - a3 * c3, height) + d4[:, None] * across
    at = at + d5[:, None] * z4 + (d6 + TCP_OFFSET_M)[:, None] * z5
    at = at + torch.cat([base[..., :2], zero[..., None]], -1)
    turn = torch.stack([x6, y6, z5], -1)
    return torch.cat([at, turn.flatten(-2)], -1)


def upright(poses: Tensor) -> Tensor:
    """Return x, y, z and yaw of poses (..., robots, 12), (..., robots, 4) [m, rad]."""
    yaw = torch.atan2(poses[..., 6], poses[..., 3])
    return torch.cat([poses[..., :3], yaw[..., None]], -1)


def pose_joints(pose: Tensor, base: Tensor, arms: Arms, near: Tensor) -> Tensor:
    """Return the inverse kinematics of poses, (..., robots, 6) [rad].

    The solution is in closed form, in the branch of the parking pose, so shoulder,
    elbow and wrist never flip. For a target out of reach the arm is stretched towards
    it.

    Args:
        pose: Poses of the tool center points, (..., robots, 12).
        base: x, y and yaw of each base, (..., robots, 3) [m, rad].
        arms: The robots' arms.
        near: Joint angles, (..., robots, 6) [rad]; full turns are added to the result
            to come near them.
    """
    d1, a2, a3, d4, d5, d6 = arms.dh.unbind(-1)
    shoulder, wrist, elbow = arms.branch.unbind(-1)
    turn = pose[..., 3:].view(*pose.shape[:-1], 3, 3)
    x6, y6, z6 = turn.unbind(-1)
    stand = torch.cat([base[..., :2], torch.zeros_like(base[..., :1])], -1)
    at = pose[..., :3] - stand - (TCP_OFFSET_M + d6)[:, None] * z6
    radius = torch.linalg.vector_norm(at[..., :2], dim=-1).clamp_min(_EPS)
    heading = torch.atan2(at[..., 1], at[..., 0])
    first = heading + shoulder * torch.acos((d4 / radius).clamp(-1, 1)) + math.pi / 2
    c1, s1, zero = torch.cos(first), torch.sin(first), torch.zeros_like(first)
    away, across = torch.stack([c1, s1, zero], -1), torch.stack([s1, -c1, zero], -1)
    c5 = _dot(z6, across).clamp(-1, 1)
    q5 = wrist * torch.acos(c5)
    x4 = wrist[:, None] * (across * c5[..., None] - z6)
    whole = torch.atan2(x4[..., 2], _dot(x4, away))
    c, s = torch.cos(whole), torch.sin(whole)
    z4 = torch.cat([s[..., None] * away[..., :2], -c[..., None]], -1)
    q6 = torch.atan2(-_dot(x6, z4), -_dot(y6, z4))
    at = at - d5[:, None] * z4
    x, y = _dot(at, away), at[..., 2] - d1
    cos_q3 = (x * x + y * y - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
    q3 = elbow * torch.acos(cos_q3.clamp(-1, 1))
    q2 = torch.atan2(-y, -x) - torch.atan2(a3 * torch.sin(q3), a2 + a3 * torch.cos(q3))
    found = torch.stack([first - base[..., 2], q2, q3, whole - q2 - q3, q5, q6], -1)
    turned = found - math.tau * torch.round((found - near) / math.tau)
    # Joint limits are one full turn.
    return torch.where(turned.abs() > math.tau, found, turned)


def moved(pose: Tensor, rows: Tensor, here: Tensor) -> Tensor:
    """Return the next target poses, (..., robots, 12).

    As mode ``delta_ee_pose`` on the CPU: steps along and about the axes of the world,
    from the last target, which is at most two steps ahead of the hand. The fingertips
    stay above the table.

    Args:
        pose: The last target poses, (..., robots, 12).
        rows: Actions in [-1, 1], (..., robots, 7); the last number is not used.
        here: Present poses of the hands, (..., robots, 12).
    """
    ahead = pose[..., :3] + STEP_M * rows[..., :3] - here[..., :3]
    length = torch.linalg.vector_norm(ahead, dim=-1, keepdim=True).clamp_min(_EPS)
    at = here[..., :3] + ahead * (LEASH_STEPS * STEP_M / length).clamp_max(1.0)
    x, y, z = at.unbind(-1)
    at = torch.stack(
        [
            x.clamp(LOWEST_M[0], HIGHEST_M[0]),
            y.clamp(LOWEST_M[1], HIGHEST_M[1]),
            z.clamp(max(LOWEST_M[2], LOWEST_TIP_M), HIGHEST_M[2]),
        ],
        -1,
    )
    now = here[..., 3:].view(*here.shape[:-1], 3, 3)
    last = pose[..., 3:].view(*pose.shape[:-1], 3, 3)
    wanted = _times(_turn(TURN_RAD * rows[..., 3:6]), last)
    away = _axis_angle(_times(wanted, now.transpose(-1, -2)))
    angle = torch.linalg.vector_norm(away, dim=-1, keepdim=True).clamp_min(_EPS)
    away = away * (LEASH_STEPS * TURN_RAD / angle).clamp_max(1.0)
    return torch.cat([at, _times(_turn(away), now).flatten(-2)], -1)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)


def _times(a: Tensor, b: Tensor) -> Tensor:
    """Return products of matrices, without a library that allocates memory."""
    return (a[..., :, :, None] * b[..., None, :, :]).sum(-2)


def _turn(vector: Tensor) -> Tensor:
    """Return rotation matrices of axes times angles, (..., 3, 3)."""
    angle = torch.linalg.vector_norm(vector, dim=-1)
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    cross = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).view(*x.shape, 3, 3)
    # sin(a) / a, and (1 - cos(a)) / a^2.
    one = torch.sinc(angle / math.pi)[..., None, None]
    half = torch.sinc(angle / math.tau)[..., None, None]
    unit = torch.ones_like(x)
    eye = torch.stack([unit, o, o, o, unit, o, o, o, unit], -1).view(*x.shape, 3, 3)
    return eye + one * cross + 0.5 * half * half * _times(cross, cross)


def _axis_angle(turn: Tensor) -> Tensor:
    """Return axes times angles of rotations by less than half a turn, (..., 3)."""
    twice = torch.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        -1,
    )
    trace = turn[..., 0, 0] + turn[..., 1, 1] + turn[..., 2, 2]
    length: Tensor = torch.linalg.vector_norm(twice, dim=-1)
    angle = torch.atan2(length, trace - 1.0)
    return twice * (angle / length.clamp_min(_EPS))[..., None]
