"""Teleoperation by a visitor, and the log of an episode for a file."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from threading import Lock
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lemma.core.poses import FloatArray, Pose2, quaternion_from_matrix
from lemma.dataset.recipe.record import pose_row
from lemma.dataset.teleoperation import (
    Commanded,
    Executed,
    Nudged,
    Teleoperation,
    joints_sha256,
)
from lemma.env.config import EnvConfig
from lemma.env.control.pose_controllers import HIGHEST_M, LOWEST_M
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Decision
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.tasks.instance import Instance
from lemma.tasks.suite import FREE_SPLIT

BY_HAND = "by hand"
"""Name of teleoperation among the policies of a page."""
CONTROL, CONTROL_HZ = "ee_pose", 20.0
"""Control mode and commands per second."""


class Teleoperator:
    """A policy that sends each hand to its target; safe to use from any thread.

    The targets come from the page.
    """

    control_options: ClassVar[Mapping[str, object]] = {
        "control": CONTROL,
        "control_hz": CONTROL_HZ,
        "observation": "state",
    }

    def __init__(self) -> None:
        """Begin without targets; the first observation sets them."""
        self._lock = Lock()
        self._targets: FloatArray | None = None
        self.rows: list[FloatArray] = []
        """Its commands, oldest first, each (robots, 8)."""
        self.is_done = False
        """Whether the visitor has handed back."""

    def target(self, robot: int) -> FloatArray | None:
        """Return the target of a hand in the world's frame.

        Args:
            robot: Index of the robot.

        Returns:
            Position [m], quaternion wxyz and opening [m], (8,); None before the first
            observation.
        """
        with self._lock:
            return None if self._targets is None else self._targets[robot].copy()

    def lead(self, robot: int, position: ArrayLike, wxyz: ArrayLike) -> None:
        """Set the target of a hand, within the range of commands.

        Args:
            robot: Index of the robot.
            position: Tool centre point in the world's frame, (3,) [m].
            wxyz: Its quaternion, (4,).
        """
        with self._lock:
            if self._targets is not None:
                turn = np.asarray(wxyz, float)
                self._targets[robot, :3] = np.clip(position, LOWEST_M, HIGHEST_M)
                self._targets[robot, 3:7] = turn / np.linalg.norm(turn)

    def grip(self, robot: int, *, opened: bool) -> None:
        """Open or close a gripper.

        Args:
            robot: Index of the robot.
            opened: Whether to open it.
        """
        with self._lock:
            if self._targets is not None:
                self._targets[robot, 7] = FINGER_OPENING_M if opened else 0.0

    def _begin(self, poses: FloatArray, openings: FloatArray) -> None:
        """Set the targets to the present poses of the hands.

        Args:
            poses: Poses of the tool centre points, (robots, 7) [m, wxyz].
            openings: Openings of the grippers, (robots,) [m].
        """
        with self._lock:
            self._targets = np.hstack([poses, openings[:, None]])
            self._targets[:, :3] = np.clip(poses[:, :3], LOWEST_M, HIGHEST_M)
            self._targets[:, 3:7] = np.clip(poses[:, 3:], -1.0, 1.0)

    def _row(self) -> FloatArray:
        """Return the targets as a command, (robots, 8), and record it."""
        with self._lock:
            assert self._targets is not None
            row = self._targets.copy()
            self.rows.append(row)
        return row

    def act(self, inputs: Sequence[ControlInput]) -> list[Any]:
        """Return the targets as commands, one per input."""
        (control_input,) = inputs
        if self._targets is None:
            seen = control_input.observation
            poses = np.asarray(seen["tcp_pose"], float).reshape(-1, 7)
            joints = np.asarray(seen["agent_pos"], float).reshape(len(poses), -1)
            self._begin(poses, joints[:, -1])
        return [Actions(self._row())]

    def take_over(self, episode: Episode) -> None:
        """Control an episode until it is over or the visitor hands back.

        Args:
            episode: The episode, in any state; its running sub-task is interrupted.
        """
        options: dict[str, Any] = dict(self.control_options)
        env = ControlEnv(
            EnvConfig(task=episode.instance.task, split=FREE_SPLIT, **options)
        )
        env.take_over(episode)
        arms = [*episode.simulation.arms.values()]
        poses = [arm.tcp_pose() for arm in arms]
        self._begin(
            np.array([[*p[:3, 3], *quaternion_from_matrix(p[:3, :3])] for p in poses]),
            # Commanded instead of measured openings, so that grippers keep holding.
            np.array([arm.opening_m for arm in arms]),
        )
        while not (self.is_done or episode.is_over):
            env.advance(self._row())


class EpisodeLog:
    """Log of sub-tasks and commands; only the simulating thread writes it."""

    def __init__(self) -> None:
        """Begin an empty log."""
        self._parts: tuple[Executed | Commanded, ...] = ()
        self._nudged: tuple[Nudged, ...] = ()
        self._begun: Executed | None = None

    @property
    def by_hand(self) -> bool:
        """Whether a visitor did something."""
        led = any(isinstance(part, Commanded) and part.rows for part in self._parts)
        return led or bool(self._nudged)

    def begin(self, decision: Decision, start_s: float) -> None:
        """Log a decision of the policy; one without poses is not executed.

        Args:
            decision: The policy's decision.
            start_s: Simulated time [s].
        """
        subtask, grounded = decision.subtask, decision.grounded
        self._begun = None
        if grounded is not None:
            self._begun = Executed.begin(start_s, subtask, grounded)

    def end(self, until_s: float | None = None) -> None:
        """Log the end of the running sub-task.

        Args:
            until_s: Simulated time of its interruption [s]; None if it was finished.
        """
        if self._begun is not None:
            self._parts = (*self._parts, replace(self._begun, until_s=until_s))
            self._begun = None

    def lead(self, teleoperator: Teleoperator, start_s: float) -> None:
        """Log that a visitor leads from now on.

        Args:
            teleoperator: The teleoperator, which records the commands.
            start_s: Simulated time [s].
        """
        led = Commanded(CONTROL, CONTROL_HZ, teleoperator.rows, start_s)
        self._parts = (*self._parts, led)

    def move(self, name: str, pose: Pose2, time_s: float) -> None:
        """Log that a visitor moved an object.

        Args:
            name: Name of the object.
            pose: Its new pose in the world's frame.
            time_s: Simulated time [s].
        """
        self._nudged = (*self._nudged, Nudged(time_s, name, pose_row(pose)))

    def kept(
        self, instance: Instance, said: str, latest: tuple[float, FloatArray]
    ) -> Teleoperation:
        """Return the whole log.

        Args:
            instance: The instance.
            said: The sentence.
            latest: Simulated time [s] and joint positions, (nq,), of the last state.
        """
        parts = self._parts if self._begun is None else (*self._parts, self._begun)
        end_s, qpos = latest
        return Teleoperation(
            instance,
            said,
            tuple(part for part in parts if part.start_s < end_s),
            self._nudged,
            end_s,
            joints_sha256(qpos),
        )
