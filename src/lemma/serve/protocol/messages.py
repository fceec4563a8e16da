"""Messages of the policy protocol: what is said, as plain data and arrays.

A message is a map with a ``type``; docs/serving.md lists them all. Here they are still
independent of how they travel.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lemma.core.poses import Pose2, matrix_from_quaternion
from lemma.env.view import View
from lemma.policies.interfaces import Decision
from lemma.serve.protocol.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

PROTOCOL = 1
"""Version of the protocol: the first thing that both sides compare."""
METHODS = ("act", "plan", "ground")
"""What a policy may be able to do."""

Message = dict[str, Any]
"""One message."""

VIEW_TYPES: dict[str, tuple[type[np.generic], int]] = {
    "rgb": (np.uint8, 3),
    "height_m": (np.float32, 2),
    "coverage": (np.bool_, 2),
    "joints": (np.float64, 2),
    "opening_m": (np.float64, 1),
}
"""Type and number of dimensions of every array of a view."""

_UPRIGHT = 0.02


def view_to_message(view: View) -> Message:
    """Return a view as a map of arrays."""
    return {
        name: np.ascontiguousarray(getattr(view, name), dtype)
        for name, (dtype, _) in VIEW_TYPES.items()
    }


def view_from_message(data: Mapping[str, Any]) -> View:
    """Return the view that :func:`view_to_message` described.

    Raises:
        ProtocolError: An array is missing, or of another type or shape.
    """
    arrays: dict[str, Any] = {}
    for name, (dtype, dimensions) in VIEW_TYPES.items():
        array = data.get(name)
        if not isinstance(array, np.ndarray):
            raise ProtocolError(f"The view lacks the array {name!r}.")
        if array.dtype != dtype or array.ndim != dimensions:
            raise ProtocolError(
                f"The array {name!r} of a view is {array.dtype} with {array.ndim} "
                f"dimensions, not {np.dtype(dtype)} with {dimensions}."
            )
        arrays[name] = array
    return View(**arrays)


def decision_to_message(decision: Decision) -> Message:
    """Return a decision: symbols, and poses if there are any.

    Raises:
        PolicyFailedError: It is none.
    """
    _check_type(decision, Decision)
    grounded = decision.grounded
    return {
        "subtask": subtask_to_message(decision.subtask),
        "grounded": None if grounded is None else grounded_to_message(grounded),
        "explanation": str(decision.explanation),
    }


def decision_from_message(data: object) -> Decision:
    """Return the decision that a message describes.

    Raises:
        PolicyFailedError: It describes none.
    """
    answer = _map(data, "decision")
    grounded = answer.get("grounded")
    return Decision(
        subtask_from_message(answer.get("subtask")),
        None if grounded is None else grounded_from_message(grounded),
        str(answer.get("explanation", "")),
    )


def subtask_to_message(subtask: SubTask) -> Message:
    """Return a sub-task as four strings.

    Raises:
        PolicyFailedError: It is none.
    """
    _check_type(subtask, SubTask)
    return {
        "robot": str(subtask.robot),
        "primitive": str(subtask.primitive),
        "pick": str(subtask.pick),
        "place": str(subtask.place),
    }


def subtask_from_message(data: object) -> SubTask:
    """Return the sub-task that a message describes.

    Raises:
        PolicyFailedError: It describes none.
    """
    answer = _map(data, "sub-task")
    words = [answer.get(name, "") for name in ("robot", "pick", "place")]
    if not all(isinstance(word, str) for word in words):
        raise malformed(f"robot, pick and place of a sub-task are {words}, not text")
    return SubTask(words[0], _primitive(answer.get("primitive")), words[1], words[2])


def grounded_to_message(grounded: GroundedSubTask) -> Message:
    """Return a grounded sub-task; poses are x [m], y [m] and yaw [rad].

    Raises:
        PolicyFailedError: It is none.
    """
    _check_type(grounded, GroundedSubTask)
    return {
        "robot": str(grounded.robot),
        "primitive": str(grounded.primitive),
        "pick": _three(grounded.pick),
        "place": _three(grounded.place),
    }


def grounded_from_message(data: object) -> GroundedSubTask:
    """Return the grounded sub-task that a message describes.

    Raises:
        PolicyFailedError: It describes none.
    """
    answer = _map(data, "grounded sub-task")
    robot = answer.get("robot")
    if not isinstance(robot, str):
        raise malformed(f"the robot of a grounded sub-task is {robot!r}, not text")
    return GroundedSubTask(
        robot,
        _primitive(answer.get("primitive")),
        pose_from_message(answer.get("pick")),
        pose_from_message(answer.get("place")),
    )


def pose_from_message(data: object) -> Pose2:
    """Return a pose on the table, in the world frame.

    Args:
        data: ``[x, y, yaw]`` in metres and radians; or a pose in space, ``{"position":
            [x, y, z], "quaternion": [w, x, y, z]}``, of a gripper that points down.

    Raises:
        PolicyFailedError: It is neither.
    """
    if isinstance(data, Mapping):
        x, y, _ = _numbers(data.get("position"), 3, "The position of a pose")
        quaternion = _numbers(data.get("quaternion"), 4, "The quaternion of a pose")
        return Pose2(x, y, yaw_of(quaternion))
    return Pose2(*_numbers(data, 3, "A pose"))


def yaw_of(quaternion: list[float]) -> float:
    """Return the yaw [rad] of a gripper that points down.

    Args:
        quaternion: Unit quaternion ``wxyz``.

    Raises:
        PolicyFailedError: It is no unit quaternion, or the gripper points elsewhere.
    """
    if not all(math.isfinite(value) for value in quaternion):
        return math.nan
    if abs(math.hypot(*quaternion) - 1.0) > _UPRIGHT:
        raise malformed(f"the quaternion {quaternion} does not have length one")
    rotation = matrix_from_quaternion(np.asarray(quaternion, np.float64))
    if rotation[2, 2] > _UPRIGHT - 1.0:
        raise malformed(
            f"the gripper does not point down under the quaternion {quaternion}; its "
            "order is w, x, y, z"
        )
    return math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))


def entries(message: Mapping[str, Any], name: str) -> list[Any]:
    """Return a list of a message.

    Raises:
        ProtocolError: The message has no such list.
    """
    value = message.get(name)
    if not isinstance(value, list | tuple):
        raise ProtocolError(f"The message {message.get('type')!r} lacks {name!r}.")
    return list(value)


def _map(data: object, what: str) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        raise malformed(f"a {what} is a map, not {short(data)}")
    return data


def _primitive(word: object) -> Primitive:
    try:
        return Primitive(str(word))
    except ValueError:
        valid = ", ".join(Primitive)
        raise PolicyFailedError(
            FaultKind.UNKNOWN_NAME,
            f"The policy names no primitive but {short(word)}; valid: {valid}.",
        ) from None


def _numbers(data: object, count: int, what: str) -> list[float]:
    values = data.tolist() if isinstance(data, np.ndarray) else data
    if (
        not isinstance(values, list | tuple)
        or len(values) != count
        or not all(_is_number(v) for v in values)
    ):
        raise malformed(f"{what.lower()} is {count} numbers, not {short(data)}")
    return [float(v) for v in values]


def _is_number(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool)


def _three(pose: Pose2) -> list[float]:
    _check_type(pose, Pose2)
    values = (pose.x, pose.y, pose.yaw)
    if not all(isinstance(v, float | int | np.number) for v in values):
        raise malformed(f"{short(pose)} does not consist of numbers")
    return [float(v) for v in values]


def _check_type(value: object, wanted: type) -> None:
    if not isinstance(value, wanted):
        raise malformed(f"{short(value)} is no {wanted.__name__}")


def malformed(what: str) -> PolicyFailedError:
    """Return the error that says so of an answer."""
    return PolicyFailedError(
        FaultKind.MALFORMED, f"The policy's answer cannot be used: {what}."
    )


def short(value: object, longest: int = 80) -> str:
    """Return a value as people can bear to read it."""
    text = repr(value)
    return text if len(text) <= longest else f"{text[:longest]}..."
