"""Control modes: the meaning of an action's numbers, and the controller for them."""

from dataclasses import dataclass

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.env.action_spaces import ActionLayout
from lemma.env.control.controllers import (
    Controller,
    PositionController,
    TorqueController,
    VelocityController,
)
from lemma.env.control.pose_controllers import (
    HIGHEST_FROM_BASE_M,
    HIGHEST_M,
    LOWEST_FROM_BASE_M,
    LOWEST_M,
    AxisAnglePoseController,
    DeltaPoseController,
    DeltaRot6dPoseController,
    PoseController,
    Rot6dPoseController,
    Rot6dWaypointController,
    WaypointController,
)
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.ur.build import ARMS, JOINTS
from lemma.scene.build import ACTUATIONS


@dataclass(frozen=True, kw_only=True)
class ControlMode:
    """Meaning of the numbers of an action, and the controller that obeys them."""

    summary: str
    """One line for people."""
    actuation: str
    """How the motors are driven; see :data:`lemma.scene.build.ACTUATIONS`."""
    columns: tuple[str, ...]
    """Names of one robot's numbers; the gripper's is last."""
    low: tuple[float, ...]
    """Smallest values."""
    high: tuple[float, ...]
    """Largest values."""
    controller: type[Controller]
    """Drives the arms."""

    def __post_init__(self) -> None:
        """Check the way of driving the motors, and that each number has its bounds.

        Raises:
            UnknownNameError: Motors cannot be driven so.
            InvalidConfigError: A number has no bounds, or they do not ascend.
        """
        known("actuation", self.actuation, ACTUATIONS)
        count = len(self.columns)
        bounds = list(zip(self.low, self.high, strict=False))
        if not count == len(self.low) == len(self.high) or any(
            not low < high for low, high in bounds
        ):
            raise InvalidConfigError(
                f"A control mode with the numbers {', '.join(self.columns)} needs as "
                f"many bounds, low < high, and not {self.low} and {self.high}."
            )

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


def _pose_mode(
    summary: str,
    driver: type[PoseController],
    low: tuple[float, ...] = LOWEST_M,
    high: tuple[float, ...] = HIGHEST_M,
) -> ControlMode:
    turn = driver.rotation
    limits = [turn.limit] * len(turn.columns)
    return ControlMode(
        summary=summary,
        actuation="position",
        columns=("x", "y", "z", *turn.columns, "opening"),
        low=(*low, *(-limit for limit in limits), 0.0),
        high=(*high, *limits, FINGER_OPENING_M),
        controller=driver,
    )


def _delta_mode(summary: str, driver: type[DeltaPoseController]) -> ControlMode:
    turn = driver.rotation
    columns = ("dx", "dy", "dz", *turn.columns, "gripper")
    return ControlMode(
        summary=summary,
        actuation="position",
        columns=columns,
        low=(-1.0,) * len(columns),
        high=(1.0,) * len(columns),
        controller=driver,
    )


_FROM_BASE = (LOWEST_FROM_BASE_M, HIGHEST_FROM_BASE_M)

CONTROLS: Registry[ControlMode] = Registry("control mode", ControlMode)
"""The control modes by name. Bounds are those of the strongest arm type; a weaker arm
does what it can."""
CONTROLS.add(
    "ee_pose",
    _pose_mode(
        "Pose of the tool centre point in the world, quaternion wxyz.", PoseController
    ),
)
CONTROLS.add(
    "ee_pose_axis_angle",
    _pose_mode("The same, axis and angle [rad].", AxisAnglePoseController),
)
CONTROLS.add(
    "ee_pose_rot6d",
    _pose_mode(
        "The same, first two columns of the rotation matrix.", Rot6dPoseController
    ),
)
CONTROLS.add(
    "ee_waypoint",
    _pose_mode(
        "Pose in the frame of the robot's base; an arm that has far to turn swings "
        "round first.",
        WaypointController,
        *_FROM_BASE,
    ),
)
CONTROLS.add(
    "ee_waypoint_rot6d",
    _pose_mode(
        "The same, first two columns of the rotation matrix.",
        Rot6dWaypointController,
        *_FROM_BASE,
    ),
)
CONTROLS.add(
    "delta_ee_pose",
    _delta_mode(
        "Steps of the tool centre point's target, in [-1, 1]; axis and angle.",
        DeltaPoseController,
    ),
)
CONTROLS.add(
    "delta_ee_pose_rot6d",
    _delta_mode(
        "The same, first two columns of the rotation matrix.", DeltaRot6dPoseController
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
