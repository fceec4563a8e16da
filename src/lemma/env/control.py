"""Control modes: from numbers sent 20 times a second to what the motors are told.

Whatever is asked for, a motor stays inside the limits of its robot. References move at
no more than 95% of a joint's velocity limit and with a bounded acceleration, servos are
never told to catch up faster than that, and raw torques give way to braking as a joint
comes near its limit: a real robot would stop for protection instead.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numba import njit

from lemma.core.errors import InvalidActionError
from lemma.core.poses import FloatArray, matrix_from_quaternion
from lemma.core.registry import Registry
from lemma.env.spaces import Layout
from lemma.motion.arm import ArmMotion
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.ur import ARMS, JOINTS
from lemma.scene.compose import TABLE_HALF_X_M, TABLE_HALF_Y_M, TIME_STEP_S

SPEED_FRACTION = 0.95
"""Of a joint's velocity limit: what references keep to."""
ACCELERATION_RAD_S2 = 10.0
"""Largest acceleration of a joint's reference: what a stretched arm can follow."""
CEILING_M = 1.5
"""Highest position of the tool centre point that can be asked for."""

_ARM_RANGE_M = 0.15
"""From where on an arm feels the others, as in skills."""
_BRAKE_REGION_RAD_S = 0.4
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
        self.speed_limits = np.array(spec.velocity_limits)
        self.speeds = SPEED_FRACTION * self.speed_limits
        self.range = np.array(spec.joint_range)

    def check(self, row: FloatArray) -> None:  # noqa: B027 - bounds are mostly enough
        """Raise what is wrong with a row of an action; changes nothing.

        Raises:
            InvalidActionError: It is in bounds, and still makes no sense.
        """

    @abstractmethod
    def command(self, row: FloatArray) -> None:
        """Take note of a row of an action; the last number is the gripper's opening."""

    def tick(self) -> None:  # noqa: B027 - most modes have nothing to do
        """Look around, once per servo tick."""

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
        """Keep clear of where the other arms are now."""
        rows = [np.zeros((0, 8))]
        for other in self.others:
            capsules = other.capsules()
            rows.append(np.c_[capsules, np.full(len(capsules), _ARM_RANGE_M)])
        self.arm.set_obstacles(np.concatenate(rows))

    def drive(self) -> None:
        """Advance the reference."""
        self.arm.step()
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
        approach(self.arm.state, self._target, self.speeds)
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
        self._wanted[:] = row[:6]
        self.arm.opening_m = float(row[6])

    def drive(self) -> None:
        """Command what the joints' speeds allow."""
        data, robot = self.arm.scene.data, self.arm.robot
        self.arm.state[0] = data.qpos[robot.qpos]
        self.arm.state[1] = data.qvel[robot.dof]
        allowed = np.empty(6)
        brake(self.arm.state, self._wanted, self.speeds, self._efforts, allowed)
        data.ctrl[robot.ctrl] = allowed
        data.ctrl[robot.gripper_ctrl] = self.arm.opening_m


@dataclass(frozen=True, kw_only=True)
class ControlMode:
    """What an action commands."""

    summary: str
    """One line for people."""
    actuation: str
    """How the motors are driven; see :data:`lemma.scene.compose.ACTUATIONS`."""
    columns: tuple[str, ...]
    """Names of one robot's numbers, the gripper's opening [m] last."""
    low: tuple[float, ...]
    """Smallest values."""
    high: tuple[float, ...]
    """Largest values."""
    controller: type[Controller]
    """Drives one arm."""

    def layout(self, robots: tuple[str, ...]) -> Layout:
        """Return the meaning of an action for some robots."""
        return Layout(robots, self.columns, self.low, self.high)


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


@njit(cache=True)
def saturate(control: FloatArray, q: FloatArray, span: FloatArray) -> None:
    """Bring commands (6,) within ``span`` of the joint angles, in place [rad]."""
    for i in range(6):
        control[i] = min(q[i] + span[i], max(q[i] - span[i], control[i]))


@njit(cache=True)
def approach(state: FloatArray, target: FloatArray, speeds: FloatArray) -> None:
    """Advance a reference, (2, 6), by one physics step towards joint angles.

    The speed is the largest from which each joint can still stop at its target.
    """
    h, a = TIME_STEP_S, ACCELERATION_RAD_S2
    for i in range(6):
        error = target[i] - state[0, i]
        gap = abs(error)
        speed = 0.5 * (math.sqrt(a * h * a * h + 8.0 * a * gap) - a * h)
        speed = min(speed, speeds[i], gap / h)
        wanted = speed if error > 0.0 else -speed
        change = min(a * h, max(-a * h, wanted - state[1, i]))
        state[1, i] += change
        state[0, i] += state[1, i] * h


@njit(cache=True)
def accelerate(
    state: FloatArray, wanted: FloatArray, speeds: FloatArray, limits: FloatArray
) -> None:
    """Advance the speeds of a reference, (2, 6), by one physics step.

    A joint slows down so that it stops before the end of its range.
    """
    h, a = TIME_STEP_S, ACCELERATION_RAD_S2
    for i in range(6):
        up = min(speeds[i], math.sqrt(2.0 * a * max(0.0, limits[i] - state[0, i])))
        down = min(speeds[i], math.sqrt(2.0 * a * max(0.0, limits[i] + state[0, i])))
        goal = min(up, max(-down, wanted[i]))
        state[1, i] += min(a * h, max(-a * h, goal - state[1, i]))


@njit(cache=True)
def brake(
    state: FloatArray,
    wanted: FloatArray,
    speeds: FloatArray,
    efforts: FloatArray,
    out: FloatArray,
) -> None:
    """Write the torques, (6,), that the speeds of the joints allow to ``out``.

    Up to its speed a joint gets what is asked for, if the motor has it. Within a small
    region around its speed what drives it on gives way to full braking.
    """
    for i in range(6):
        rate = state[1, i]
        sign = 1.0 if rate > 0.0 else -1.0
        room = (speeds[i] - abs(rate)) / _BRAKE_REGION_RAD_S
        most = efforts[i] * min(1.0, max(-1.0, room))
        torque = min(efforts[i], max(-efforts[i], wanted[i]))
        out[i] = sign * min(sign * torque, most)
