"""Control modes: the layout of an action, and its controller."""

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


@dataclass(frozen=True)
class ControlMode:
    """Layout of an action, and the controller that executes it."""

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
        """Check the actuation, and that each column has bounds.

        Raises:
            UnknownNameError: There is no such actuation.
            InvalidConfigError: A column has no bounds, or its bounds are not ascending.
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
        """Return the action layout for some robots."""
        return ActionLayout(robots, self.columns, self.low, self.high)


def _strongest(field: str) -> tuple[float, ...]:
    """Return the largest limit of each joint over the arm types."""
    limits = [getattr(ARMS[name], field) for name in ARMS]
    return tuple(max(column) for column in zip(*limits, strict=True))


_IN_WORLD = (LOWEST_M, HIGHEST_M)
_FROM_BASE = (LOWEST_FROM_BASE_M, HIGHEST_FROM_BASE_M)
_POSE_MODES = (
    (
        *("ee_pose", PoseController, _IN_WORLD),
        "Pose of the tool centre point in the world, quaternion wxyz.",
    ),
    (
        *("ee_pose_axis_angle", AxisAnglePoseController, _IN_WORLD),
        "The same, axis and angle [rad].",
    ),
    (
        *("ee_pose_rot6d", Rot6dPoseController, _IN_WORLD),
        "The same, first two columns of the rotation matrix.",
    ),
    (
        *("ee_waypoint", WaypointController, _FROM_BASE),
        "Pose in the frame of the robot's base; an arm that has far to turn swings "
        "round first.",
    ),
    (
        *("ee_waypoint_rot6d", Rot6dWaypointController, _FROM_BASE),
        "The same, first two columns of the rotation matrix.",
    ),
)
"""Name, controller, corners of the box of positions, and summary."""
_STEP_MODES = (
    (
        *("delta_ee_pose", DeltaPoseController),
        "Steps of the tool centre point's target, in [-1, 1]; axis and angle.",
    ),
    (
        *("delta_ee_pose_rot6d", DeltaRot6dPoseController),
        "The same, first two columns of the rotation matrix.",
    ),
)
"""Name, controller and summary."""
_JOINT_MODES = (
    (
        *("joint_position", PositionController, "position", "joint_range"),
        "Joint angles [rad].",
    ),
    (
        *("joint_velocity", VelocityController, "velocity", "velocity_limits"),
        "Joint speeds [rad/s].",
    ),
    (
        *("joint_torque", TorqueController, "torque", "effort_limits"),
        "Joint torques beside those that balance gravity [N m].",
    ),
)
"""Name, controller, actuation, field of an arm that bounds the numbers, and summary."""

CONTROLS: Registry[ControlMode] = Registry("control mode", ControlMode)
"""The control modes by name. Bounds are those of the strongest arm type; the motions of
weaker arms are limited further."""


def _add_modes() -> None:
    for name, driver, (low, high), summary in _POSE_MODES:
        turn = driver.rotation
        limits = (turn.limit,) * len(turn.columns)
        columns = ("x", "y", "z", *turn.columns, "opening")
        bottom = (*low, *(-limit for limit in limits), 0.0)
        top = (*high, *limits, FINGER_OPENING_M)
        CONTROLS.add(
            name, ControlMode(summary, "position", columns, bottom, top, driver)
        )
    for name, stepper, summary in _STEP_MODES:
        columns = ("dx", "dy", "dz", *stepper.rotation.columns, "gripper")
        top = (1.0,) * len(columns)
        bottom = (-1.0,) * len(columns)
        CONTROLS.add(
            name, ControlMode(summary, "position", columns, bottom, top, stepper)
        )
    for name, mover, actuation, field, summary in _JOINT_MODES:
        limits = _strongest(field)
        columns = (*JOINTS, "opening")
        bottom = (*(-limit for limit in limits), 0.0)
        top = (*limits, FINGER_OPENING_M)
        CONTROLS.add(name, ControlMode(summary, actuation, columns, bottom, top, mover))


_add_modes()
