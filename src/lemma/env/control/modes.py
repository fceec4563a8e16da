"""Control modes: from numbers sent 20 times a second to what the motors are told.

Whatever is asked for, a motor stays inside the limits of its robot. References move at
no more than 95% of a joint's velocity limit and with a bounded acceleration, servos are
never told to catch up faster than that, and torques that would make a joint too fast
within a physics step are replaced by those that make it just as fast as it may be. The
same holds for what would ram an arm into something, see
:mod:`lemma.env.control.safety_filter`. A real robot would stop for protection instead.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidActionError
from lemma.core.poses import FloatArray
from lemma.core.registry import Registry
from lemma.env.action_spaces import ActionLayout
from lemma.env.control.motor_commands import (
    drive_poses,
    drive_positions,
    drive_torques,
    drive_velocities,
    find_moving,
)
from lemma.env.control.pose_targets import aim_arms
from lemma.env.control.safety_filter import SafetyFilter
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.ur.build import ARMS, JOINTS
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M

CEILING_M = 1.5
"""Highest position of the tool centre point that can be asked for."""

_LEAST_NORM = 1e-3


class Controller(ABC):
    """Drives the arms of a scene from what an action says, one row for each."""

    def __init__(self, arms: Sequence[ArmMotion]) -> None:
        """Take over the arms where they are.

        Args:
            arms: All arms of a scene, in the order of an action's rows.
        """
        self.arms = arms
        self.scene = arms[0].scene
        self.guard = SafetyFilter(arms)
        self.openings = np.array([arm.opening_m for arm in arms])
        """What the grippers shall open to, (n,) [m]."""
        self.states = np.stack([arm.state for arm in arms])
        """The references of all arms, (n, 2, 6) [rad, rad/s]."""
        for arm, state in zip(arms, self.states, strict=True):
            # The same memory: whoever moves or restores an arm moves it here.
            arm.state = state
        data = self.scene.data
        self.qvel: FloatArray = data.qvel
        self.given = (
            *(self.guard.records, self.states, self.openings),
            *(self.guard.obstacles, self.guard.objects),
            *(data.qpos, data.ctrl),
        )
        """What every kernel of :mod:`lemma.env.control.motor_commands` takes first."""
        self._moving = np.zeros(len(arms), bool)

    def check(self, rows: FloatArray) -> None:  # noqa: B027 - bounds are mostly enough
        """Raise what is wrong with an action; changes nothing.

        Raises:
            InvalidActionError: It is in bounds, and still makes no sense.
        """

    def command(self, rows: FloatArray) -> None:
        """Take note of an action, (n, k); last in a row is the gripper's opening."""
        self.openings[:] = rows[:, -1]
        for arm, opening_m in zip(self.arms, self.openings.tolist(), strict=True):
            arm.opening_m = opening_m

    def look(self) -> None:
        """Look around, once per servo tick."""
        self.guard.look()

    @abstractmethod
    def drive(self) -> None:
        """Command the motors, before every physics step."""

    def moving(self) -> list[bool]:
        """Return which arms move: a joint by 0.02 rad/s or a finger by 2 mm/s."""
        find_moving(self.guard.records, self.qvel, self._moving)
        return self._moving.tolist()


class PoseController(Controller):
    """Goes to poses of the tool centre points under RMPflow."""

    def __init__(self, arms: Sequence[ArmMotion]) -> None:
        """Take over the arms where they are."""
        super().__init__(arms)
        spaces = [arm.workspace for arm in arms]
        self._workspaces = np.concatenate([space.record for space in spaces])
        self._spheres = np.stack([space.spheres for space in spaces])
        self._parks = np.stack([arm.park for arm in arms])
        self._rows = np.empty((len(arms), 8))
        for k, space in enumerate(spaces):
            # The same memory, again.
            space.record = self._workspaces[k : k + 1]

    def check(self, rows: FloatArray) -> None:
        """Refuse a quaternion without a direction."""
        for arm, row in zip(self.arms, rows.tolist(), strict=True):
            norm = math.hypot(*row[3:7])
            if norm < _LEAST_NORM:
                raise InvalidActionError(
                    f"The quaternion of {arm.robot.name} has length {norm:g}, so it "
                    "is no rotation. Any other length is fine: it is normalised. "
                    "Pointing down is (qw, qx, qy, qz) = (0, 1, 0, 0)."
                )

    def command(self, rows: FloatArray) -> None:
        """Aim at positions [m] and quaternions wxyz in the world."""
        super().command(rows)
        self._rows[:] = rows
        aim_arms(
            *(self.guard.records, self.states, self._parks),
            *(self._rows, self._workspaces),
        )

    def drive(self) -> None:
        """Advance the references."""
        drive_poses(*self.given, self._workspaces, self._spheres)


class JointController(Controller):
    """Takes a number for each joint."""

    def __init__(self, arms: Sequence[ArmMotion]) -> None:
        """Take over the arms where they are; every number is 0."""
        super().__init__(arms)
        self.wanted = np.zeros((len(arms), 6))

    def command(self, rows: FloatArray) -> None:
        """Take note of joint angles [rad], speeds [rad/s] or torques [N m]."""
        super().command(rows)
        self.wanted[:] = rows[:, :6]


class PositionController(JointController):
    """Leads the joints to angles, along a trapezoid of speed each."""

    def drive(self) -> None:
        """Advance the references."""
        drive_positions(*self.given, self.wanted)


class VelocityController(JointController):
    """Turns the joints at given speeds; they stop at the ends of their range."""

    def drive(self) -> None:
        """Advance the reference speeds; their angles are the measured."""
        drive_velocities(*self.given, self.wanted)


class TorqueController(JointController):
    """Passes torques on, on top of gravity compensation, unless a joint is too fast."""

    def __init__(self, arms: Sequence[ArmMotion]) -> None:
        """Exert nothing."""
        super().__init__(arms)
        data, count = self.scene.data, self.scene.model.nv
        self._efforts = np.array([arm.robot.arm.effort_limits for arm in arms])
        self._inertia = np.empty((count, count))
        self._forces: tuple[FloatArray, ...] = (data.qfrc_bias, data.qfrc_passive)

    def command(self, rows: FloatArray) -> None:
        """Exert joint torques [N m]."""
        super().command(rows)
        np.clip(self.wanted, -self._efforts, self._efforts, out=self.wanted)

    def drive(self) -> None:
        """Command what the joints' speeds allow."""
        self._update_dynamics()
        drive_torques(*self.given, self.wanted, self.qvel, self._inertia, *self._forces)

    def _update_dynamics(self) -> None:
        """Compute inertias and bias forces of the present state."""
        model, data = self.scene.model, self.scene.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_passive(model, data)
        mujoco.mj_rne(model, data, 0, data.qfrc_bias)
        mujoco.mj_fullM(model, data, self._inertia)


@dataclass(frozen=True, kw_only=True)
class ControlMode:
    """What an action commands."""

    summary: str
    """One line for people."""
    actuation: str
    """How the motors are driven; see :data:`lemma.scene.build.ACTUATIONS`."""
    columns: tuple[str, ...]
    """Names of one robot's numbers, the gripper's opening [m] last."""
    low: tuple[float, ...]
    """Smallest values."""
    high: tuple[float, ...]
    """Largest values."""
    controller: type[Controller]
    """Drives the arms."""

    def layout(self, robots: tuple[str, ...]) -> ActionLayout:
        """Return the meaning of an action for some robots."""
        return ActionLayout(robots, self.columns, self.low, self.high)


def _strongest(field: str) -> tuple[float, ...]:
    """Return the largest value of a limit of every joint, over the arm types."""
    limits = [getattr(ARMS[name], field) for name in ARMS]
    return tuple(max(column) for column in zip(*limits, strict=True))


def _joint_mode(
    summary: str, actuation: str, limits: tuple[float, ...], driver: type[Controller]
) -> ControlMode:
    return ControlMode(
        summary=summary,
        actuation=actuation,
        columns=(*JOINTS, "opening"),
        low=(*(-limit for limit in limits), 0.0),
        high=(*limits, FINGER_OPENING_M),
        controller=driver,
    )


_CORNER = (TABLE_HALF_X_M, TABLE_HALF_Y_M, CEILING_M)

CONTROLS: Registry[ControlMode] = Registry("control mode")
"""The control modes by name. Bounds are those of the strongest arm type; a weaker arm
does what it can."""
CONTROLS.add(
    "ee_pose",
    ControlMode(
        summary="Pose of the tool centre point in the world, quaternion wxyz.",
        actuation="position",
        columns=("x", "y", "z", "qw", "qx", "qy", "qz", "opening"),
        low=(-TABLE_HALF_X_M, -TABLE_HALF_Y_M, 0.0, -1.0, -1.0, -1.0, -1.0, 0.0),
        high=(*_CORNER, 1.0, 1.0, 1.0, 1.0, FINGER_OPENING_M),
        controller=PoseController,
    ),
)
CONTROLS.add(
    "joint_position",
    _joint_mode(
        "Joint angles [rad].", "position", _strongest("joint_range"), PositionController
    ),
)
CONTROLS.add(
    "joint_velocity",
    _joint_mode(
        "Joint speeds [rad/s].",
        "velocity",
        _strongest("velocity_limits"),
        VelocityController,
    ),
)
CONTROLS.add(
    "joint_torque",
    _joint_mode(
        "Joint torques beside those that balance gravity [N m].",
        "torque",
        _strongest("effort_limits"),
        TorqueController,
    ),
)
