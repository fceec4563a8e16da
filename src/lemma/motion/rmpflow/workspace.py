"""Memory of RMPflow: arm, goal and leaves in one flat record."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray
from lemma.motion.rmpflow.leaves import Leaves


class ArmModel(NamedTuple):
    """Constants of the arm that RMPflow moves."""

    dh: FloatArray
    """(6,) [m]."""
    world_from_base: FloatArray
    """(4, 4)."""
    tcp_offset_m: float
    """Distance of the tool centre point beyond the flange, along its z axis."""
    lower: FloatArray
    """Lower joint limits, (6,) [rad]."""
    upper: FloatArray
    velocity_limits: FloatArray
    """(6,) [rad/s]."""
    sphere_links: FloatArray
    """Link frame that each collision sphere is attached to, (n,)."""
    spheres: FloatArray
    """Centre in that frame, then the radius, (n, 4) [m]."""
    sphere_meets_table: FloatArray
    """1 where the table is an obstacle for the sphere, (n,)."""
    base_radius_m: float = 0.0
    """Radius of the arm's own base, an obstacle for wrist and gripper [m]."""


class ArmTarget(NamedTuple):
    """The goal of the arm's motion."""

    position: FloatArray
    """World position of the tool centre point, (3,) [m]."""
    rotation: FloatArray
    """World from gripper, (3, 3)."""
    posture: FloatArray
    """Preferred joint angles, (6,) [rad]."""
    target_weight: float
    """Weight of position and rotation: 1, or 0 to follow the posture alone."""
    posture_weight: float
    """Weight of the posture: 1, or more to follow the posture alone."""


_GOAL = np.dtype(
    [
        ("position", np.float64, 3),
        ("rotation", np.float64, (3, 3)),
        ("posture", np.float64, 6),
        ("target_weight", np.float64),
        ("posture_weight", np.float64),
    ]
)
_LEAVES = np.dtype(
    [
        (name, [(field, np.float64) for field in getattr(leaf, "_fields", ())] or float)
        for name, leaf in Leaves()._asdict().items()
    ]
)
_RECORD = np.dtype(
    [
        # Sum over the leaves; the metric's lower triangle only.
        ("metric", np.float64, (6, 6)),
        ("force", np.float64, 6),
        # Link frames, and their motion at zero joint acceleration.
        ("frames", np.float64, (7, 4, 4)),
        ("omega", np.float64, (7, 3)),
        ("omega_dot", np.float64, (7, 3)),
        ("origin_acceleration", np.float64, (7, 3)),
        # Scratch memory of one leaf.
        ("jacobian", np.float64, (3, 6)),
        ("row", np.float64, 6),
        ("column", np.float64, (1, 7)),
        ("low", np.float64, 3),
        ("high", np.float64, 3),
        ("point", np.float64, 3),
        ("error", np.float64, 3),
        ("velocity", np.float64, 3),
        ("wanted", np.float64, 3),
        ("weight", np.float64, (3, 3)),
        ("acceleration", np.float64, 6),
        # Constants within a call.
        ("dh", np.float64, 6),
        ("world_from_base", np.float64, (4, 4)),
        ("tcp_offset_m", np.float64),
        ("base_radius_m", np.float64),
        ("lower", np.float64, 6),
        ("upper", np.float64, 6),
        ("velocity_limits", np.float64, 6),
        ("goal", _GOAL),
        ("leaves", _LEAVES),
    ]
)


class Workspace:
    """Memory of one arm: inputs of its leaves and their sum.

    Numba gets one flat record as a single pointer. It would unpack named tuples at
    every call, which took longer than RMPflow itself.
    """

    def __init__(self) -> None:
        """Start with zeros."""
        self.record: NDArray[np.void] = np.zeros(1, _RECORD)
        self.spheres: FloatArray = np.zeros((0, 6))
        """Centre [m], radius [m], link frame, 1 if it meets the table: (n, 6)."""

    def load(self, arm: ArmModel, goal: ArmTarget, leaves: Leaves) -> None:
        """Copy an arm, a goal and the parameters of the leaves into the record."""
        row = self.record[0]
        row["leaves"] = leaves
        for name in ("dh", "world_from_base", "lower", "upper", "velocity_limits"):
            row[name] = getattr(arm, name)
        row["tcp_offset_m"] = arm.tcp_offset_m
        row["base_radius_m"] = arm.base_radius_m
        self.spheres = np.column_stack(
            [arm.spheres, arm.sphere_links, arm.sphere_meets_table]
        )
        self.goal = goal

    @property
    def goal(self) -> ArmTarget:
        """A copy of the goal in the record."""
        row = self.record[0]["goal"]
        return ArmTarget(*(row[name].copy() for name in ArmTarget._fields))

    @goal.setter
    def goal(self, goal: ArmTarget) -> None:
        row = self.record[0]["goal"]
        for name, value in zip(goal._fields, goal, strict=True):
            row[name] = value
