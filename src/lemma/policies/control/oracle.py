"""The expert as policies at control level: its motion, and its key poses.

They show that actions of these kinds can solve the tasks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from lemma.core.errors import InvalidConfigError
from lemma.env.control.key_poses import KeyPose, Progress
from lemma.env.control_env import ControlEnv
from lemma.expert.key_poses import next_key_poses
from lemma.expert.policy import MODE, JointMotion
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.control.moving import KEY_POSE_OPTIONS, Moving
from lemma.policies.interfaces import Oracle


@dataclass(frozen=True, eq=False, kw_only=True)
class OracleControlInput(ControlInput):
    """Input of an oracle, with the simulation."""

    env: ControlEnv = field(repr=False)
    """The environment with its simulation."""


class ExpertControl(Oracle):
    """Returns the motion of the expert's next sub-task as one chunk."""

    control_options: ClassVar[Mapping[str, object]] = {
        "control": MODE,
        "control_hz": 20.0,
        "observation": "state",
    }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return a chunk of actions for each episode.

        Raises:
            InvalidConfigError: The inputs are no :class:`OracleControlInput`.
        """
        return [self._act(control_input) for control_input in inputs]

    def _act(self, control_input: ControlInput) -> Actions:
        motion = control_input.memory or JointMotion(_oracle_input(control_input).env)
        return Actions(motion.next_chunk(), motion)


@dataclass(frozen=True, eq=False)
class _Memory:
    """The expert's memory between two key poses."""

    progress: Progress
    ahead: tuple[KeyPose, ...] = ()
    """Further key poses of the sub-task."""


class ExpertKeyPoses(Oracle):
    """Moves through the expert's key poses.

    It is an upper bound for policies that learn key poses, with the same motions.
    """

    control_options: ClassVar[Mapping[str, object]] = {
        **KEY_POSE_OPTIONS,
        "observation": "state",
    }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return the next waypoints of each episode.

        Raises:
            InvalidConfigError: The inputs are no :class:`OracleControlInput`.
        """
        return [self._act(control_input) for control_input in inputs]

    def _act(self, control_input: ControlInput) -> Actions:
        episode, memory = _oracle_input(control_input).env.episode, control_input.memory
        moving = Moving.of(control_input, memory and memory.progress)
        ahead = memory.ahead if memory else ()
        if moving.rows is None:
            if not (ahead and moving.holds(ahead[0].robot)):
                _, ahead = next_key_poses(episode)
            key, *rest = ahead
            moving, ahead = moving.towards(key), tuple(rest)
        return moving.actions(_Memory(moving.progress, ahead))


def _oracle_input(control_input: ControlInput) -> OracleControlInput:
    if not isinstance(control_input, OracleControlInput):
        raise InvalidConfigError("The expert needs an OracleControlInput.")
    return control_input
