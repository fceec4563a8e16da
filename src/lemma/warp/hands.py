"""Where hands are, from joint angles, for many arms at once in torch."""

import torch
from torch import Tensor

from lemma.policies.control.hand_steps import Arms
from lemma.robots.gripper import TCP_OFFSET_M


def hand_poses(q: Tensor, base: Tensor, arms: Arms) -> Tensor:
    """Return the poses of tool centre points in the world, (..., robots, 12).

    The same as :func:`lemma.robots.ur.kinematics.forward`. Joints 2, 3 and 4 turn about
    parallel axes, so that the arm stands in one vertical plane up to its first wrist.

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
    # Away from the base in the arm's plane, and across that plane.
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
    """Return x, y, z and yaw of such poses, (..., robots, 4) [m, rad]."""
    yaw = torch.atan2(poses[..., 6], poses[..., 3])
    return torch.cat([poses[..., :3], yaw[..., None]], -1)
