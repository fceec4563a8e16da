"""Initial states with the hand near a grasp, for reinforcement learning."""

import math

import torch
from torch import Tensor

from lemma.policies.control.hand_steps import GRIP_M, Arms, joints
from lemma.robots.gripper import FINGER_OPENING_M

GRASPED_M = 0.0498
"""Opening of fingers that have closed on a cube [m]."""


def starts(
    at: Tensor,
    quarter_rad: float,
    base: Tensor,
    arms: Arms,
    angles: Tensor,
    noise: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return states of arms near a grasp.

    In half of them the open hand is over the object, in 30 % around it, and in the
    others the fingers are closed on it.

    Args:
        at: Grasp pose of the object in the world: x, y, z, yaw, (..., 1, 4) [m, rad].
        quarter_rad: Rotational symmetry of the grasp, or 0 [rad].
        base: Base poses x, y, yaw in the world, (..., robots, 3) [m, rad].
        arms: The robots' arms.
        angles: Present joint angles, (..., robots, 6) [rad].
        noise: Uniform in [0, 1), (..., 1, 5).

    Returns:
        Joint angles (..., robots, 6) [rad]; opening and commanded opening (..., 1) [m];
        and whether each arm can reach its state, (..., robots).
    """
    kind, middle = noise[..., 4:], 2.0 * noise - 1.0
    over, around = kind < 0.5, (kind >= 0.5) & (kind < 0.8)
    beside = torch.where(over, 0.06, torch.where(around, 0.01, 0.003)) * middle[..., :2]
    low = torch.where(over, 0.06, 0.0)
    high = torch.where(over, 0.15, torch.where(around, 0.04, 0.005))
    height = at[..., 2:3] + low + (high - low) * noise[..., 2:3]
    turn = torch.where(over, math.pi, torch.where(around, 0.15, 0.0)) * middle[..., 3:4]
    if quarter_rad:
        turn = turn + quarter_rad * torch.floor(4.0 * noise[..., 3:4]) * ~over
    spot = torch.cat([at[..., :2] + beside, height, at[..., 3:] + turn], -1)
    q = joints(spot.expand(*base.shape[:-1], 4), base, arms, angles)
    closed = ~over[..., 0] & ~around[..., 0]
    opening = torch.where(closed, GRASPED_M, FINGER_OPENING_M)
    asked = torch.where(closed, GRASPED_M - GRIP_M, FINGER_OPENING_M)
    radius = torch.linalg.vector_norm(spot[..., :2] - base[..., :2], dim=-1)
    possible = (radius >= arms.radii[:, 0]) & (radius <= arms.radii[:, 1])
    return q, opening, asked, possible
