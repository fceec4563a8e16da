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
from dataclasses import dataclass

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidActionError
from lemma.core.poses import FloatArray, matrix_from_quaternion
from lemma.core.registry import Registry
from lemma.env.action_spaces import ActionLayout
from lemma.env.control.joint_limits import (
    accelerate,
    advance,
    approach,
    bound,
    predict,
    saturate,
    steer,
)
from lemma.env.control.safety_filter import SafetyFilter
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.ur.build import ARMS, JOINTS
from lemma.scene.build import TABLE_HALF_X_M, TABLE_HALF_Y_M, TIME_STEP_S
from lemma.scene.scene import Scene

SPEED_FRACTION = 0.95
"""Of a joint's velocity limit: what references keep to."""
CEILING_M = 1.5
"""Highest position of the tool centre point that can be asked for."""

_ARM_RANGE_M = 0.15
"""From where on an arm feels the others, as in skills."""
_LEAST_NORM = 1e-3


class Controller(ABC):
    """Drives one arm from what one row of an action says."""

    def __init__(self, arm: ArmMotion, others: tuple[ArmMotion, ...]) -> None:
        """Take over an arm where it is.

        Args:
            arm: The arm.
            others: The other arms, to keep clear of.
        """
        self.arm = arm
        self.others = others
        spec = arm.robot.arm
        self.speeds = SPEED_FRACTION * np.array(spec.velocity_limits)
        self.range = np.array(spec.joint_range)
        self.guard = SafetyFilter(arm, others)

    def check(self, row: FloatArray) -> None:  # noqa: B027 - bounds are mostly enough
        """Raise what is wrong with a row of an action; changes nothing.

        Raises:
            InvalidActionError: It is in bounds, and still makes no sense.
        """

    @abstractmethod
    def command(self, row: FloatArray) -> None:
        """Take note of a row of an action; the last number is the gripper's opening."""

    def tick(self) -> None:
        """Look around, once per servo tick."""
        self.guard.look()

    @abstractmethod
    def drive(self) -> None:
        """Command the motors, before every physics step."""


class PoseController(Controller):
    """Goes to a pose of the tool centre point under RMPflow."""

    def check(self, row: FloatArray) -> None:
        """Refuse a quaternion without a direction."""
        norm = _norm(row[3:7])
        if norm < _LEAST_NORM:
            raise InvalidActionError(
                f"The quaternion of {self.arm.robot.name} has length {norm:g}, so it "
                "is no rotation. Any other length is fine: it is normalised. Pointing "
                "down is (qw, qx, qy, qz) = (0, 1, 0, 0)."
            )

    def command(self, row: FloatArray) -> None:
        """Aim at a position [m] and a quaternion wxyz in the world."""
        pose = np.eye(4)
        pose[:3, :3] = matrix_from_quaternion(row[3:7] / _norm(row[3:7]))
        pose[:3, 3] = row[:3]
        self.arm.aim(pose, self.arm.solve_posture(pose))
        self.arm.opening_m = float(row[7])

    def tick(self) -> None:
        """Look around, and let RMPflow know where the other arms are."""
        super().tick()
        rows = [np.zeros((0, 8))]
        for other in self.others:
            capsules = other.capsules()
            rows.append(np.c_[capsules, np.full(len(capsules), _ARM_RANGE_M)])
        self.arm.set_obstacles(np.concatenate(rows))

    def drive(self) -> None:
        """Advance the reference."""
        before = self.arm.state[0].copy()
        self.arm.step()
        rates = (self.arm.state[0] - before) / TIME_STEP_S
        if self.guard.restrain(before, rates, self.speeds):
            self.arm.state[0] = before + TIME_STEP_S * rates
            self.arm.state[1] = rates
            self.arm.command()
        _temper(self.arm, self.speeds)


class PositionController(Controller):
    """Leads the joints to angles, along a trapezoid of speed each."""

    def __init__(self, arm: ArmMotion, others: tuple[ArmMotion, ...]) -> None:
        """Stay where the reference is."""
        super().__init__(arm, others)
        self._target = arm.state[0].copy()

    def command(self, row: FloatArray) -> None:
        """Go to joint angles [rad]."""
        self._target[:] = row[:6]
        self.arm.opening_m = float(row[6])

    def drive(self) -> None:
        """Advance the reference."""
        state = self.arm.state
        approach(state, self._target, self.speeds)
        self.guard.restrain(state[0], state[1], self.speeds)
        advance(state, self.range)
        self.arm.command()
        _temper(self.arm, self.speeds)


class VelocityController(Controller):
    """Turns the joints at given speeds; they stop at the ends of their range."""

    def __init__(self, arm: ArmMotion, others: tuple[ArmMotion, ...]) -> None:
        """Stand still."""
        super().__init__(arm, others)
        self._wanted = np.zeros(6)

    def command(self, row: FloatArray) -> None:
        """Turn at joint speeds [rad/s]."""
        self._wanted[:] = row[:6]
        self.arm.opening_m = float(row[6])

    def drive(self) -> None:
        """Advance the reference speed; the angles of the reference are the measured."""
        data, robot = self.arm.scene.data, self.arm.robot
        self.arm.state[0] = data.qpos[robot.qpos]
        accelerate(self.arm.state, self._wanted, self.speeds, self.range)
        self.guard.restrain(self.arm.state[0], self.arm.state[1], self.speeds)
        data.ctrl[robot.ctrl] = self.arm.state[1]
        data.ctrl[robot.gripper_ctrl] = self.arm.opening_m


class TorqueController(Controller):
    """Passes torques on, on top of gravity compensation, unless a joint is too fast."""

    def __init__(self, arm: ArmMotion, others: tuple[ArmMotion, ...]) -> None:
        """Exert nothing."""
        super().__init__(arm, others)
        self._wanted = np.zeros(6)
        self._efforts = np.array(arm.robot.arm.effort_limits)

    def command(self, row: FloatArray) -> None:
        """Exert joint torques [N m]."""
        self._wanted[:] = np.clip(row[:6], -self._efforts, self._efforts)
        self.arm.opening_m = float(row[6])

    def drive(self) -> None:
        """Command what the joints' speeds allow."""
        data, robot = self.arm.scene.data, self.arm.robot
        self.arm.state[0] = data.qpos[robot.qpos]
        self.arm.state[1] = data.qvel[robot.dof]
        scene, span = self.arm.scene, robot.dof
        full = np.empty((scene.model.nv, scene.model.nv))
        mujoco.mj_fullM(scene.model, data, full)
        inertia = np.ascontiguousarray(full[span, span])
        bias = data.qfrc_bias[span] - data.qfrc_passive[span]
        rates = np.empty(6)
        predict(inertia, bias, self._wanted, self.arm.state[1], rates)
        bounded = bound(self.arm.state[0], rates, self.speeds, self.range)
        guarded = self.guard.restrain(self.arm.state[0], rates, self.speeds)
        torques = self._wanted.copy()
        if bounded or guarded:
            steer(inertia, bias, rates - self.arm.state[1], self._efforts, torques)
        data.ctrl[robot.ctrl] = torques
        data.ctrl[robot.gripper_ctrl] = self.arm.opening_m


def update_dynamics(scene: Scene) -> None:
    """Compute inertias and bias forces of the present state, for the torque mode."""
    model, data = scene.model, scene.data
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_makeM(model, data)
    mujoco.mj_comVel(model, data)
    mujoco.mj_passive(model, data)
    mujoco.mj_rne(model, data, 0, data.qfrc_bias)


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
    """Drives one arm."""

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


def _norm(quaternion: FloatArray) -> float:
    return math.sqrt(sum(value * value for value in quaternion.tolist()))


def _temper(arm: ArmMotion, speeds: FloatArray) -> None:
    """Keep position servos from catching up faster than the joints may turn.

    The servo's torque is zero where ``(ctrl - q) / lag`` is the speed: bounding that
    bounds the speed, whatever held the arm back.
    """
    data, robot = arm.scene.data, arm.robot
    saturate(data.ctrl[robot.ctrl], data.qpos[robot.qpos], robot.arm.lag_s * speeds)
