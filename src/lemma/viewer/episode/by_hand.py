"""A robot that a visitor leads: a policy whose decisions come from the page."""

from collections.abc import Mapping, Sequence
from threading import Lock
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lemma.core.poses import FloatArray
from lemma.env.control.pose_controllers import HIGHEST_M, LOWEST_M
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.control.recorded import Recording
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.tasks.instance import Instance

BY_HAND = "by hand"
"""Its name among the policies of a page."""
_MODE, _HZ = "ee_pose", 20.0


class ByHand:
    """Sends each robot to where its target is; safe to use from any thread."""

    control_options: ClassVar[Mapping[str, object]] = {
        "control": _MODE,
        "control_hz": _HZ,
        "observation": "state",
    }

    def __init__(self) -> None:
        """Begin without targets: the first look says where the hands are."""
        self._lock = Lock()
        self._targets: FloatArray | None = None
        self._rows: list[FloatArray] = []

    def target(self, robot: int) -> FloatArray | None:
        """Return where a hand shall be: position [m], quaternion wxyz, opening [m]."""
        with self._lock:
            return None if self._targets is None else self._targets[robot].copy()

    def lead(self, robot: int, position: ArrayLike, wxyz: ArrayLike) -> None:
        """Send a hand somewhere, as far as commands go.

        Args:
            robot: Its number.
            position: Of the tool centre point [m].
            wxyz: Its quaternion.
        """
        with self._lock:
            if self._targets is not None:
                at = np.clip(position, LOWEST_M, HIGHEST_M)
                turn = np.asarray(wxyz, float)
                self._targets[robot, :3] = at
                self._targets[robot, 3:7] = turn / np.linalg.norm(turn)

    def grip(self, robot: int, *, opened: bool) -> None:
        """Open or close a gripper.

        Args:
            robot: Its number.
            opened: Whether to open it.
        """
        with self._lock:
            if self._targets is not None:
                self._targets[robot, 7] = FINGER_OPENING_M if opened else 0.0

    def act(self, inputs: Sequence[ControlInput]) -> list[Any]:
        """Return the targets as commands, and keep them."""
        (given,) = inputs
        with self._lock:
            if self._targets is None:
                seen = given.observation
                poses = np.asarray(seen["tcp_pose"], float).reshape(-1, 7)
                joints = np.asarray(seen["agent_pos"], float).reshape(len(poses), -1)
                self._targets = np.hstack([poses, joints[:, -1:]])
                self._targets[:, :3] = np.clip(poses[:, :3], LOWEST_M, HIGHEST_M)
                self._targets[:, 3:7] = np.clip(poses[:, 3:], -1.0, 1.0)
            row = self._targets.copy()
            self._rows.append(row)
        return [Actions(row)]

    def recording(self, instance: Instance) -> Recording:
        """Return what was done so far.

        Args:
            instance: At which table.
        """
        with self._lock:
            return Recording(instance, _MODE, _HZ, tuple(self._rows))
