"""An arm as the compiled side of a controller sees it: one flat record.

Records of all arms enter Numba as a single pointer, which makes a call cheap: there is
one before every physics step and one in every servo tick.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.collision_model import envelope_of
from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGER_WIDTH_M,
    FINGERTIP_BEYOND_TCP_M,
    PALM_BEYOND_FLANGE_M,
    TCP_OFFSET_M,
)
from lemma.robots.ur.arms import ArmSpec

SPEED_FRACTION = 0.95
"""Share of a joint's velocity limit that references keep to."""
CAPSULES = 10
"""Capsules of one arm, see :class:`~lemma.robots.collision_model.Envelope`."""
CORNERS = 8
"""Number of corners of the fingers, wide open, and of the palm."""
INNER_LINKS = 4
"""Links, from the base on, that outer parts of the same arm may come near."""
_PARTS = CAPSULES + CORNERS

ARM = np.dtype(
    [
        # Constants of the arm.
        ("dh", np.float64, 6),
        ("world_from_base", np.float64, (4, 4)),
        # Capsules, then corners: ends and radius in the frame of a link, the link, and
        # a bound of how far a joint speed of norm 1 moves them.
        ("parts", np.float64, (_PARTS, 9)),
        ("levers", np.float64, _PARTS),
        ("speeds", np.float64, 6),
        ("range", np.float64, 6),
        ("efforts", np.float64, 6),
        ("lag_s", np.float64),
        # Its indices in the arrays of the simulation.
        ("qpos", np.int64),
        ("dof", np.int64),
        ("ctrl", np.int64),
        ("gripper_ctrl", np.int64),
        ("fingers", np.int64, 2),
        # How many objects are beside the hand and in it.
        ("beside", np.int64),
        ("inside", np.int64),
        # Poses of its links, and how they move: angular velocity, and velocity of
        # what is at the origin of the world.
        ("placed", np.float64, (7, 4, 4)),
        ("twists", np.float64, (7, 6)),
        # Its parts in the world; their ends and the twists of their links again, one
        # part a column.
        ("world", np.float64, (_PARTS, 12)),
        ("ends", np.float64, (6, _PARTS)),
        ("part_twists", np.float64, (6, _PARTS)),
        # Gaps at which parts can still stop, seen from the inner links.
        ("gaps", np.float64, (INNER_LINKS, _PARTS)),
    ]
)


def arm_records(arms: Sequence[ArmMotion]) -> NDArray[np.void]:
    """Return the records of arms of one scene, (n,)."""
    records = np.zeros(len(arms), ARM)
    for row, arm in zip(records, arms, strict=True):
        robot, spec = arm.robot, arm.robot.arm
        row["dh"] = spec.dh
        row["world_from_base"] = robot.world_from_base
        row["parts"] = _parts(spec)
        row["levers"] = row["parts"][:, 8]
        row["speeds"] = SPEED_FRACTION * np.array(spec.velocity_limits)
        row["range"] = spec.joint_range
        row["efforts"] = spec.effort_limits
        row["lag_s"] = spec.lag_s
        row["qpos"], row["dof"] = robot.qpos.start, robot.dof.start
        row["ctrl"], row["gripper_ctrl"] = robot.ctrl.start, robot.gripper_ctrl
        row["fingers"] = robot.finger_qpos
    return records


def _parts(spec: ArmSpec) -> FloatArray:
    """Return capsules and corners: ends, radius, link and lever, (n, 9)."""
    envelope = envelope_of(spec.name)
    rows = np.zeros((_PARTS, 9))
    rows[:CAPSULES, :7] = envelope.capsules
    rows[:CAPSULES, 7] = envelope.capsule_links
    corners = _corners()
    rows[CAPSULES:, :3] = rows[CAPSULES:, 3:6] = corners
    rows[CAPSULES:, 7] = 6.0
    for row in rows:
        # An upper bound of the distance from an axis: the sum of the links between.
        span = max(math.hypot(*row[:3]), math.hypot(*row[3:6]))
        levers = []
        for length in np.abs(spec.dh[: int(row[7])])[::-1]:
            span += float(length)
            levers.append(span)
        row[8] = math.hypot(*levers)
    return rows


def _corners() -> list[tuple[float, float, float]]:
    """Return corners in the frame of the flange [m]."""
    return [
        (x * side, y * across, z)
        for x, y, z in (
            (
                FINGER_WIDTH_M / 2,
                FINGER_OPENING_M / 2 + FINGER_THICKNESS_M,
                TCP_OFFSET_M + FINGERTIP_BEYOND_TCP_M,
            ),
            (0.030, 0.056, PALM_BEYOND_FLANGE_M),
        )
        for side in (-1.0, 1.0)
        for across in (-1.0, 1.0)
    ]
