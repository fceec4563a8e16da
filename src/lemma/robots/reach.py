"""Reachable sets: one function for sampling, expert, allocation and reach maps.

A robot reaches a table position if closed-form inverse kinematics has a solution with
the gripper pointing down, at grasp height *and* at travel height, inside the joint
limits and clear of the table and of itself. A gripper that points down turns about the
vertical with the last joint alone, and the base turns all the way round, so reach
depends on the distance to the base and on nothing else: a ring per arm type. (Where the
fingers turn next to the base, the inner edge moves by up to 2 mm.) That is computed
once, and a test compares it with inverse kinematics over the plane.
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
"""Height of the tool centre point when it grasps what lies on the table."""
TRAVEL_HEIGHT_M = 0.30
"""Height of the tool centre point when it carries something (paper, section IV)."""

_CLEARANCE_M = 0.01
_RESOLUTION_M = 0.001
_LARGEST_M = 2.0


@dataclass(frozen=True)
class Reach:
    """The ring around its base that an arm type reaches."""

    inner_m: float
    """Nearer than this the arm would touch itself."""
    travel_m: float
    """Up to here the arm grasps and carries: the radius of reach."""
    grasp_m: float
    """Beyond this it cannot grasp anything with its hand pointing down. A tilted hand
    gets farther: see :mod:`lemma.robots.could`."""

    def margin(self, base: Pose2, x: float, y: float) -> float:
        """Return how far inside the ring a position is [m]; negative outside."""
        r = math.hypot(x - base.x, y - base.y)
        return min(r - self.inner_m, self.travel_m - r)

    def hold_margin(self, base: Pose2, x: float, y: float) -> float:
        """Return how far inside the ring in which it holds things low [m].

        An object that was lifted elsewhere may be held, pushed and let go there.
        """
        r = math.hypot(x - base.x, y - base.y)
        return min(r - self.inner_m, self.grasp_m - r)


def gripper_ik(
    arm_name: str, world_from_base: FloatArray, pose: FloatArray
) -> FloatArray:
    """Return every usable joint vector that puts the tool centre point at a pose.

    Args:
        arm_name: Arm type.
        world_from_base: (4, 4).
        pose: World from gripper, at the tool centre point, (4, 4).

    Returns:
        Joint angles, (n, 6) [rad]: inside the limits, clear of the table and of the arm
        itself.
    """
    dh, joint_range, links, capsules = ik_constants(arm_name)
    return usable_postures(dh, world_from_base, pose, joint_range, links, capsules)


@lru_cache
def ik_constants(
    arm_name: str,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what :func:`usable_postures` needs of an arm type.

    Returns:
        ``dh``, ``joint_range``, ``links`` and ``capsules``.
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
    """Do what :func:`gripper_ik` does, for kernels; see there.

    Args:
        dh: Of the arm, (6,) [m].
        base: World from base, (4, 4).
        pose: World from gripper, (4, 4).
        joint_range: Largest angles, (6,) [rad].
        links: Link that each capsule is fixed to, (n,).
        capsules: Ends and radius in the frame of the link, (n, 7) [m].
    """
    local = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                local[i, j] += base[k, i] * pose[k, j]
        for k in range(3):
            # The flange sits behind the tool centre point.
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
    """Whether the gripper can point down at a position of the world [m]."""
    return len(gripper_ik(arm_name, base.matrix(), top_down(x, y, z, 0.0))) > 0


@lru_cache
def reach_of(arm_name: str) -> Reach:
    """Return the reach of an arm type."""
    origin = Pose2(0.0, 0.0)

    def edges(z: float) -> tuple[float, float]:
        """Bisect the two edges of the ring at one height."""
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
    """Rasterise the reach of a robot over the table.

    Args:
        arm_name: Arm type.
        base: World from base.
        x: World x of the columns, (W,) [m].
        y: World y of the rows, (H,) [m].

    Returns:
        Margin [m], (H, W): positive where the robot reaches.
    """
    reach = reach_of(arm_name)
    distance = np.sqrt((x[None, :] - base.x) ** 2 + (y[:, None] - base.y) ** 2)
    return np.minimum(distance - reach.inner_m, reach.travel_m - distance)
