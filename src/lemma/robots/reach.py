"""Reachable sets, for sampling, expert, allocation and reach maps alike.

A robot reaches a table position if closed-form inverse kinematics has a solution with
the gripper pointing down, at grasp height *and* at travel height, inside the joint
limits and without contact with the table or the arm itself. For a gripper that points
down, the last joint alone sets the yaw, and the base turns through a full circle. So
reach depends on the distance to the base alone: the reachable set is an annulus per
arm type. (Where the fingers turn next to the base, its inner radius varies by up to
2 mm.) The radii are computed once; a test compares them with inverse kinematics over
the plane.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray, Pose2
from lemma.robots.collision_model import (
    envelope_of,
    place_capsules,
    self_clearance,
    table_clearance,
)
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.ur.build import ARMS
from lemma.robots.ur.kinematics import frames, inverse, top_down

GRASP_HEIGHT_M = 0.02
"""Height of the tool centre point when it grasps an object on the table."""
TRAVEL_HEIGHT_M = 0.30
"""Height of the tool centre point when it carries an object (paper, section IV)."""

_CLEARANCE_M = 0.01
_RESOLUTION_M = 0.001
_LARGEST_M = 2.0


@dataclass(frozen=True)
class Reach:
    """The reachable set of an arm type: an annulus around its base."""

    inner_m: float
    """Inner radius [m]; nearer than this the arm collides with itself."""
    travel_m: float
    """Outer radius [m]: up to here the arm both grasps and carries."""
    grasp_m: float
    """Largest distance at which the arm grasps with the gripper pointing down [m]. A
    tilted gripper reaches farther: see :mod:`lemma.robots.could`."""

    def margin(self, base: Pose2, x: float, y: float) -> float:
        """Return how far inside the annulus a position is [m]; negative outside.

        Args:
            base: World from base.
            x: World x of the position [m].
            y: World y of the position [m].
        """
        r = math.hypot(x - base.x, y - base.y)
        return min(r - self.inner_m, self.travel_m - r)

    def hold_margin(self, base: Pose2, x: float, y: float) -> float:
        """Return how far inside the annulus of low positions a position is [m].

        There the arm can hold, push and release an object that it lifted elsewhere. The
        arguments are those of :meth:`margin`; the result is negative outside.
        """
        r = math.hypot(x - base.x, y - base.y)
        return min(r - self.inner_m, self.grasp_m - r)


def gripper_ik(
    arm_name: str, world_from_base: FloatArray, pose: FloatArray
) -> FloatArray:
    """Return all collision-free joint angles for a pose of the tool centre point.

    Args:
        arm_name: Arm type.
        world_from_base: (4, 4) [m].
        pose: World from gripper, at the tool centre point, (4, 4) [m].

    Returns:
        Joint angles, (n, 6) [rad], inside the limits and without contact with the table
        or the arm itself.

    Raises:
        UnknownNameError: No such arm.
    """
    dh, joint_range, links, capsules = ik_constants(arm_name)
    return usable_postures(dh, world_from_base, pose, joint_range, links, capsules)


@lru_cache
def ik_constants(
    arm_name: str,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the arguments of :func:`usable_postures` that depend on the arm type.

    Returns:
        ``dh``, ``joint_range``, ``links`` and ``capsules``.

    Raises:
        UnknownNameError: No such arm.
    """
    arm, envelope = ARMS[arm_name], envelope_of(arm_name)
    return (
        *(arm.dh, np.array(arm.joint_range)),
        *(envelope.capsule_links, envelope.capsules),
    )


@kernel
def usable_postures(
    dh: FloatArray,
    base: FloatArray,
    pose: FloatArray,
    joint_range: FloatArray,
    links: FloatArray,
    capsules: FloatArray,
) -> FloatArray:
    """Solve inverse kinematics like :func:`gripper_ik`, inside Numba kernels.

    Args:
        dh: Denavit-Hartenberg lengths of the arm, (6,) [m].
        base: World from base, (4, 4) [m].
        pose: World from gripper, at the tool centre point, (4, 4) [m].
        joint_range: Largest absolute angles, (6,) [rad].
        links: Link frame of each capsule of the arm, (n,).
        capsules: Both ends and radius in link frames, (n, 7) [m].

    Returns:
        Joint angles, (n, 6) [rad].
    """
    local = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                local[i, j] += base[k, i] * pose[k, j]
        for k in range(3):
            # From the tool centre point back to the flange.
            flange = pose[k, 3] - TCP_OFFSET_M * pose[k, 2] - base[k, 3]
            local[i, 3] += base[k, i] * flange
    local[3, 3] = 1.0
    candidates = inverse(dh, local)
    placed = np.empty((capsules.shape[0], 7))
    all_frames = np.empty((7, 4, 4))
    identity = np.eye(4)
    count = 0
    for s in range(candidates.shape[0]):
        inside = True
        for j in range(6):
            inside = inside and abs(candidates[s, j]) <= joint_range[j]
        if not inside:
            continue
        frames(dh, identity, candidates[s], all_frames)
        place_capsules(all_frames, links, capsules, placed)
        if table_clearance(placed) < _CLEARANCE_M:
            continue
        if self_clearance(placed) < _CLEARANCE_M:
            continue
        candidates[count] = candidates[s]
        count += 1
    return candidates[:count].copy()


def can_hold(arm_name: str, base: Pose2, x: float, y: float, z: float) -> bool:
    """Return whether the gripper can point down at a position in the world [m].

    Raises:
        UnknownNameError: No such arm.
    """
    return len(gripper_ik(arm_name, base.matrix(), top_down(x, y, z, 0.0))) > 0


@lru_cache
def reach_of(arm_name: str) -> Reach:
    """Return the reachable set of an arm type.

    Raises:
        UnknownNameError: No such arm.
    """
    origin = Pose2(0.0, 0.0)

    def edges(z: float) -> tuple[float, float]:
        """Return the inner and outer radius at one height [m], by bisection."""
        middle = _find_inside(arm_name, z)
        inner = _bisect(lambda r: can_hold(arm_name, origin, r, 0.0, z), middle, 0.0)
        outer = _bisect(
            lambda r: can_hold(arm_name, origin, r, 0.0, z), middle, _LARGEST_M
        )
        return inner, outer

    low, high = edges(GRASP_HEIGHT_M), edges(TRAVEL_HEIGHT_M)
    return Reach(
        inner_m=round(max(low[0], high[0]), 3),
        travel_m=round(min(low[1], high[1]), 3),
        grasp_m=round(low[1], 3),
    )


def _find_inside(arm_name: str, z: float) -> float:
    r = 0.5 * (ARMS[arm_name].a2 + ARMS[arm_name].a3)
    while not can_hold(arm_name, Pose2(0.0, 0.0), r, 0.0, z):
        r += 0.02
    return r


def _bisect(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    while abs(outside - inside) > 0.5 * _RESOLUTION_M:
        middle = 0.5 * (inside + outside)
        if holds(middle):
            inside = middle
        else:
            outside = middle
    return inside


def reach_map(arm_name: str, base: Pose2, x: FloatArray, y: FloatArray) -> FloatArray:
    """Compute the reach margin of a robot on a grid of positions.

    Args:
        arm_name: Arm type.
        base: World from base.
        x: World x of the columns, (W,) [m].
        y: World y of the rows, (H,) [m].

    Returns:
        Margin, (H, W) [m]: positive where the robot reaches.

    Raises:
        UnknownNameError: No such arm.
    """
    reach = reach_of(arm_name)
    distance = np.sqrt((x[None, :] - base.x) ** 2 + (y[:, None] - base.y) ** 2)
    return np.minimum(distance - reach.inner_m, reach.travel_m - distance)
