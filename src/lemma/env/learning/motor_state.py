"""State of arms and grippers in the layout of an action.

In data sets and imitation policies, states and actions have the same layout: states are
measured values, actions are targets.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray, matrix_from_quaternion
from lemma.env.control.pose_controllers import ROT6D
from lemma.robots.ur.build import JOINTS

Float32Array = NDArray[np.float32]
MotorControl = Literal["joint_position", "ee_waypoint_rot6d"]
JOINT_POSITION, WAYPOINT = MOTOR_CONTROLS = get_args(MotorControl)
"""The control modes with such a state."""
_DECIMALS = 6
MOTORS = {
    JOINT_POSITION: (*JOINTS, "gripper"),
    WAYPOINT: ("x", "y", "z", *ROT6D.columns, "gripper"),
}
"""Meaning of each number of a robot, by control mode."""


def motor_names(control: str, robots: Sequence[str]) -> list[str]:
    """Return the names of a team's numbers, robot by robot: ``robot_0.gripper``."""
    return [f"{robot}.{motor}" for robot in robots for motor in MOTORS[control]]


def motor_state(control: str, observation: Mapping[str, Any]) -> Float32Array:
    """Return the measured state of a team in the action layout of a control mode.

    Args:
        control: One of :data:`MOTOR_CONTROLS`.
        observation: Observation of an environment at control level: ``agent_pos``,
            ``tcp_pose`` and ``base_pose``.

    Returns:
        (robots, numbers) [m, rad].
    """
    joints = np.asarray(observation["agent_pos"], np.float32).reshape(-1, 7)
    if control == JOINT_POSITION:
        return joints
    tools, bases = (
        _matrices(observation["tcp_pose"]),
        _matrices(observation["base_pose"]),
    )
    return tool_rows(bases, tools, joints[:, -1])


def _matrices(rows: Any) -> FloatArray:
    """Return poses, (n, 4, 4), of positions and quaternions wxyz, (7 n,)."""
    found = np.tile(np.eye(4), (len(rows) // 7, 1, 1))
    for pose, row in zip(found, np.reshape(rows, (-1, 7)), strict=True):
        pose[:3, :3], pose[:3, 3] = matrix_from_quaternion(row[3:]), row[:3]
    return found


def tool_rows(
    bases: FloatArray, tools: FloatArray, openings: FloatArray | Float32Array
) -> Float32Array:
    """Return poses in the layout of ``ee_waypoint_rot6d``, in the frames of the bases.

    Args:
        bases: World from base, (n, 4, 4) [m].
        tools: World from gripper at the tool centre point, (n, 4, 4) [m].
        openings: Openings of the grippers, (n,) [m].

    Returns:
        (n, 10).
    """
    poses = np.linalg.solve(bases, tools)
    columns = [poses[:, :3, number] for number in (3, 0, 1)]
    rows = np.column_stack([*columns, openings])
    # Round: learners normalize each number by its spread, even if it is rounding noise.
    return np.round(rows, _DECIMALS).astype(np.float32)
