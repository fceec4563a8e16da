"""The log of an episode, as it is kept in a file."""

from dataclasses import replace

from lemma.core.poses import FloatArray, Pose2
from lemma.dataset.recipe.record import pose_row
from lemma.dataset.teleoperation import (
    Commanded,
    Executed,
    Nudged,
    Teleoperation,
    joints_sha256,
)
from lemma.policies.interfaces import Decision
from lemma.tasks.instance import Instance
from lemma.viewer.episode.teleoperator import CONTROL, CONTROL_HZ, Teleoperator


class EpisodeLog:
    """Sub-tasks and commands; written by the thread that simulates."""

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
        """Note a decision of the policy; without poses nothing is executed.

        Args:
            decision: Of the policy.
            start_s: Simulated time [s].
        """
        subtask, grounded = decision.subtask, decision.grounded
        self._begun = grounded and Executed.begin(start_s, subtask, grounded)

    def end(self, until_s: float | None = None) -> None:
        """Note the end of the running sub-task.

        Args:
            until_s: Simulated time at which it was broken off [s]; None if it was not.
        """
        if self._begun is not None:
            begun = self._begun
            done = replace(begun, until_s=until_s)
            self._parts, self._begun = (*self._parts, done), None

    def lead(self, teleoperator: Teleoperator, start_s: float) -> None:
        """Note that a visitor leads from now on.

        Args:
            teleoperator: Keeps the commands.
            start_s: Simulated time [s].
        """
        led = Commanded(CONTROL, CONTROL_HZ, teleoperator.rows, start_s)
        self._parts = (*self._parts, led)

    def move(self, name: str, pose: Pose2, time_s: float) -> None:
        """Note that a visitor moved a thing.

        Args:
            name: Of the thing.
            pose: Where to.
            time_s: Simulated time [s].
        """
        self._nudged = (*self._nudged, Nudged(time_s, name, pose_row(pose)))

    def kept(
        self, instance: Instance, said: str, latest: tuple[float, FloatArray]
    ) -> Teleoperation:
        """Return the whole log.

        Args:
            instance: Of the table.
            said: The sentence.
            latest: Time [s] and positions of the joints of the newest state.
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
