"""Controllers for absolute poses of the tool centre points, and for pose deltas."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lemma.core.errors import InvalidActionError
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray, quaternion_from_matrix
from lemma.env.control.controllers import Controller, StepSize
from lemma.env.control.guarded_arm import CAPSULES
from lemma.env.control.motor_commands import run_poses
from lemma.env.control.rotations import (
    Quaternion,
    axis_angle_from_quaternion,
    compose,
    quaternion_from_axis_angle,
    quaternion_from_rot6d,
)
from lemma.env.control.safety_filter import transform
from lemma.motion.arm_motion import ArmMotion, choose_posture
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M

CEILING_M = 1.5
"""Largest height of the tool centre point that an action can command [m]."""
LOWEST_M = (-TABLE_HALF_X_M, -TABLE_HALF_Y_M, 0.0)
HIGHEST_M = (TABLE_HALF_X_M, TABLE_HALF_Y_M, CEILING_M)
"""Corners of the box of tool centre points that an action can command [m]."""
LOWEST_FROM_BASE_M = (-CEILING_M, -CEILING_M, 0.0)
HIGHEST_FROM_BASE_M = (CEILING_M, CEILING_M, CEILING_M)
"""The same, in the frame of a robot's base, which stands on the table."""
LEASH_STEPS = 2.0
"""How far a target of delta actions can be ahead of the arm, in steps."""

_LEAST_NORM = 1e-3


@dataclass(frozen=True)
class Rotation:
    """A representation of rotations."""

    columns: tuple[str, ...]
    """Names of its numbers."""
    limit: float
    """Largest absolute value of each."""
    quaternion: Callable[[Sequence[float]], Quaternion | None]
    """Returns the quaternion ``wxyz``, or None if the numbers are no rotation."""
    hint: str = ""
    """Advice for a user whose numbers are no rotation."""


def _as_it_is(quaternion: Sequence[float]) -> Quaternion | None:
    w, x, y, z = quaternion
    return (w, x, y, z) if math.hypot(w, x, y, z) >= _LEAST_NORM else None


QUATERNION = Rotation(
    columns=("qw", "qx", "qy", "qz"),
    limit=1.0,
    quaternion=_as_it_is,
    hint="Any other length is fine: it is normalised. Pointing down is (qw, qx, qy, "
    "qz) = (0, 1, 0, 0).",
)
AXIS_ANGLE = Rotation(
    columns=("rx", "ry", "rz"), limit=math.pi, quaternion=quaternion_from_axis_angle
)
ROT6D = Rotation(
    columns=("r1x", "r1y", "r1z", "r2x", "r2y", "r2z"),
    limit=1.0,
    quaternion=quaternion_from_rot6d,
    hint="They are the first two columns of a rotation matrix and must not be parallel "
    "or 0. No rotation is (1, 0, 0, 0, 1, 0), pointing down (1, 0, 0, 0, -1, 0).",
)


class PoseController(Controller):
    """Moves the tool centre points to poses with RMPflow."""

    rotation = QUATERNION
    """Representation of rotations, after the position."""
    swings = False
    """Whether arms whose base has far to turn swing around first."""

    def __init__(self, arms: Sequence[ArmMotion], step: StepSize) -> None:
        """Take over the arms where they are."""
        super().__init__(arms, step)
        spaces = [arm.workspace for arm in arms]
        self._workspaces = np.concatenate([space.record for space in spaces])
        self._spheres = np.stack([space.spheres for space in spaces])
        self._parks = np.stack([arm.park for arm in arms])
        self._rows = np.empty((len(arms), 8))
        for k, space in enumerate(spaces):
            # Share memory.
            space.record = self._workspaces[k : k + 1]
        self._run = partial(
            run_poses, self.team, self._workspaces, self._spheres, self.swings
        )
        self._aim = partial(
            aim_arms,
            *(self.guard.records, self.states, self._parks),
            *(self._rows, self._workspaces),
        )

    def check(self, rows: FloatArray) -> None:
        """Refuse numbers that are no rotation."""
        for arm, row in zip(self.arms, rows[:, 3:-1].tolist(), strict=True):
            if self.rotation.quaternion(row) is None:
                length = (
                    f"quaternion of {arm.robot.name} has length {math.hypot(*row):g}"
                    if self.rotation is QUATERNION
                    else f"rotation of {arm.robot.name} is {row}"
                )
                raise InvalidActionError(
                    f"The {length}, so it is no rotation. {self.rotation.hint}"
                )

    def command(self, rows: FloatArray) -> None:
        """Set target poses in the world."""
        super().command(rows)
        for k in range(len(rows)):
            self._write_target(k, rows[k])
        self._aim()

    def _write_target(self, k: int, row: FloatArray) -> None:
        """Convert a row to the target position [m] and quaternion of arm ``k``."""
        if self.rotation is QUATERNION:
            self._rows[k, :7] = row[:7]
        else:
            self._rows[k, :3] = row[:3]
            self._rows[k, 3:7] = self._quaternion(row)

    def _quaternion(self, row: FloatArray) -> Sequence[float]:
        found = self.rotation.quaternion(row[3:-1].tolist())
        # check() has made sure of this.
        assert found is not None
        return found

    def run(self, ticks: int) -> None:
        """Advance the references and the physics by servo ticks."""
        self._run(ticks)


class AxisAnglePoseController(PoseController):
    """The same, with rotations as axis and angle."""

    rotation = AXIS_ANGLE


class Rot6dPoseController(PoseController):
    """The same, with rotations as six numbers."""

    rotation = ROT6D


class WaypointController(PoseController):
    """Moves to poses in the frames of the bases, like the expert to its waypoints.

    An arm whose base joint has far to turn first swings around in joint space, and then
    moves straight: a straight line alone may pass over the arm's own base, where the
    arm would have to fold or would stop.
    """

    swings = True

    def _write_target(self, k: int, row: FloatArray) -> None:
        base = self.arms[k].robot.world_from_base
        # Add term by term, so that the last bit does not depend on a library.
        a, b, c = row[:3].tolist()
        for i, (p, q, r, origin) in enumerate(base[:3].tolist()):
            self._rows[k, i] = p * a + q * b + r * c + origin
        w, x, y, z = self._quaternion(row)
        turn = compose(quaternion_from_matrix(base[:3, :3]), (w, x, y, z))
        self._rows[k, 3:7] = turn


class Rot6dWaypointController(WaypointController):
    """The same, with rotations as six numbers."""

    rotation = ROT6D


class DeltaPoseController(PoseController):
    """Moves the targets of the tool centre points by deltas.

    Actions are in [-1, 1]. A delta starts from the last target, or from the arm's pose
    if it has none. Targets stay in the box of :data:`LOWEST_M` and :data:`HIGHEST_M`,
    and no more than :data:`LEASH_STEPS` steps ahead of the arm, so that an arm that
    falls behind does not catch up later.
    """

    rotation = AXIS_ANGLE

    def command(self, rows: FloatArray) -> None:
        """Move the targets by one step."""
        absolute = rows.copy()
        absolute[:, -1] = (0.5 + 0.5 * rows[:, -1]) * FINGER_OPENING_M
        super().command(absolute)

    def _write_target(self, k: int, row: FloatArray) -> None:
        goal, here = self._workspaces[k]["goal"], self.arms[k].tcp_pose()
        if goal["target_weight"] > 0.0:
            position, rotation = goal["position"], goal["rotation"]
        else:
            position, rotation = here[:3, 3], here[:3, :3]
        self._rows[k, :3] = self._moved(row, position, here[:3, 3])
        self._rows[k, 3:7] = self._turned(row, rotation, here[:3, :3])

    def _moved(self, row: FloatArray, start: FloatArray, arm: FloatArray) -> FloatArray:
        """Return the next position [m]."""
        wanted = start + self.step.position_m * row[:3]
        ahead = wanted - arm
        leash = LEASH_STEPS * self.step.position_m
        distance = math.hypot(*ahead.tolist())
        if distance > leash:
            wanted = arm + ahead * (leash / distance)
        found: FloatArray = np.minimum(np.maximum(wanted, LOWEST_M), HIGHEST_M)
        return found

    def _turned(
        self, row: FloatArray, start: FloatArray, arm: FloatArray
    ) -> Sequence[float]:
        """Return the next rotation as quaternion ``wxyz``."""
        wanted = compose(self._turn(row), quaternion_from_matrix(start))
        w, x, y, z = quaternion_from_matrix(arm)
        ahead = compose(wanted, (w, -x, -y, -z))
        leash = LEASH_STEPS * self.step.rotation_rad
        return compose(_shortened(ahead, leash), (w, x, y, z))

    def _turn(self, row: FloatArray) -> Quaternion:
        """Return the rotation of one step."""
        x, y, z = (self.step.rotation_rad * row[3:6]).tolist()
        return quaternion_from_axis_angle((x, y, z))


class DeltaRot6dPoseController(DeltaPoseController):
    """The same, with rotations as six numbers, limited to the largest step."""

    rotation = ROT6D

    def _turn(self, row: FloatArray) -> Quaternion:
        w, x, y, z = self._quaternion(row)
        return _shortened((w, x, y, z), self.step.rotation_rad)


def _shortened(rotation: Quaternion, most_rad: float) -> Quaternion:
    """Return a rotation about the same axis, limited to an angle."""
    vector = axis_angle_from_quaternion(rotation)
    angle = math.hypot(*vector)
    if angle <= most_rad:
        return rotation
    return quaternion_from_axis_angle([v * most_rad / angle for v in vector])


@kernel
def aim_arms(
    records: np.ndarray,
    states: FloatArray,
    parks: FloatArray,
    rows: FloatArray,
    workspaces: np.ndarray,
) -> None:
    """Choose joint postures for target poses, and pass both to RMPflow.

    Args:
        records: Records of n arms; see :data:`~lemma.env.control.guarded_arm.ARM`.
        states: Their references, (n, 2, 6) [rad, rad/s].
        parks: Their waiting postures, (n, 6) [rad].
        rows: Target positions [m] and quaternions wxyz of any nonzero norm of the tool
            centre points in the world, (n, 8); the last column is ignored.
        workspaces: The records of RMPflow, (n,); their goals are written.
    """
    pose, unit = np.eye(4), np.empty(7)
    for k in range(records.shape[0]):
        arm, row, goal = records[k], rows[k], workspaces[k].goal
        norm = 0.0
        for i in range(3, 7):
            norm += row[i] * row[i]
        norm = math.sqrt(norm)
        for i in range(7):
            unit[i] = row[i] if i < 3 else row[i] / norm
        transform(unit, pose)
        for i in range(3):
            goal.position[i] = pose[i, 3]
            for j in range(3):
                goal.rotation[i, j] = pose[i, j]
        goal.posture[:] = states[k, 0]
        goal.target_weight = 1.0
        goal.posture_weight = 1.0
        links, capsules = arm.parts[:CAPSULES, 7], arm.parts[:CAPSULES, :7]
        choose_posture(
            arm.dh,
            arm.world_from_base,
            links,
            capsules,
            arm.range,
            parks[k],
            states[k, 0],
            pose,
            goal.posture,
        )
