"""The fallback when RMPflow stalls: checked straight lines in joint space."""

import math
from itertools import pairwise

import numpy as np

from lemma.core.poses import FloatArray
from lemma.motion.arm_motion import ArmMotion, nearest_turn
from lemma.robots.collision_model import (
    obstacle_clearance,
    self_clearance,
    table_clearance,
)
from lemma.robots.reach import gripper_ik

_CLEARANCE_M = 0.01
_SLACK_M = 1e-4
_SPEED_FRACTION = 0.4
"""Of each joint's velocity limit: a line in joint space may sweep far in the world."""
_TICK_S = 0.01
_CHECK_RAD = 0.05


def joint_path(
    arm: ArmMotion, pose: FloatArray, obstacles: FloatArray
) -> FloatArray | None:
    """Find a joint path from the reference to a gripper pose.

    Every inverse-kinematics branch is tried, nearest first, directly and through the
    arm's waiting posture.

    Args:
        arm: The arm.
        pose: World from gripper at the tool centre point, (4, 4).
        obstacles: Capsules, (n, 7) or wider [m].

    Returns:
        Joint configurations one servo tick apart, (n, 6) [rad], or None.
    """
    start = arm.state[0].copy()
    goals = []
    for q in gripper_ik(arm.robot.arm.name, arm.robot.world_from_base, pose):
        nearest_turn(q, start, arm.joint_range)
        goals.append(q)
    goals.sort(key=lambda q: float(np.abs(q - start).max()))
    for via in ((), (arm.park,)):
        for goal in goals:
            corners = [start, *via, goal]
            legs = list(pairwise(corners))
            if all(_is_free(arm, a, b, obstacles) for a, b in legs):
                return np.concatenate([_time(arm, a, b) for a, b in legs])
    return None


def _is_free(
    arm: ArmMotion, start: FloatArray, end: FloatArray, obstacles: FloatArray
) -> bool:
    """Whether the arm keeps clear all along a line.

    An arm that stalls near something starts out too close to it; that is forgiven as
    long as it does not come closer.
    """
    span = float(np.abs(end - start).max())
    steps = max(2, math.ceil(span / _CHECK_RAD))
    before = min(_CLEARANCE_M, _clearance(arm, start, obstacles))
    for i in range(1, steps + 1):
        now = _clearance(arm, start + (i / steps) * (end - start), obstacles)
        if now < before - _SLACK_M:
            return False
        before = min(_CLEARANCE_M, max(before, now))
    return True


def _clearance(arm: ArmMotion, q: FloatArray, obstacles: FloatArray) -> float:
    """Return how far an arm is from itself, the table and the obstacles [m]."""
    capsules = arm.capsules(q)
    least = min(self_clearance(capsules) + _CLEARANCE_M, table_clearance(capsules))
    if len(obstacles):
        least = min(least, obstacle_clearance(capsules, obstacles))
    return least


def _time(arm: ArmMotion, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return a smooth motion along a line: zero speed at both ends."""
    limits = _SPEED_FRACTION * np.array(arm.robot.arm.velocity_limits)
    # A cubic ease peaks at 1.5 times its mean speed.
    duration = 1.5 * float((np.abs(end - start) / limits).max())
    ticks = max(2, math.ceil(duration / _TICK_S))
    t = np.arange(1, ticks + 1) / ticks
    ease = t * t * (3.0 - 2.0 * t)
    return start + ease[:, None] * (end - start)
