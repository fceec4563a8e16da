"""The expert's key poses at control level: the upper bound of policies that learn them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from lemma.core.errors import InvalidConfigError
from lemma.env.control.key_poses import (
    CONTROL,
    CONTROL_HZ,
    FULL_M,
    KeyPose,
    Kind,
    Progress,
    go_on,
    pose_matrices,
    set_out,
)
from lemma.expert.key_poses import next_key_poses
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.control.oracle import OracleControlInput
from lemma.policies.interfaces import Oracle
import numpy as np


@dataclass(frozen=True, eq=False)
class _Memory:
    progress: Progress
    ahead: tuple[KeyPose, ...] = ()


class ExpertKeyPoses(Oracle):
    """Goes from one key pose of the expert to the next."""

    control_options: ClassVar[Mapping[str, object]] = {
        "control": CONTROL,
        "control_hz": CONTROL_HZ,
        "observation": "state",
        "clip_actions": True,
    }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return the next waypoints of each episode.

        Raises:
            InvalidConfigError: The inputs come without the truth.
        """
        return [self._act(given) for given in inputs]

    def _act(self, given: ControlInput) -> Actions:
        if not isinstance(given, OracleControlInput):
            raise InvalidConfigError("The expert is given no truth, but needs it.")
        seen = given.observation
        hands, bases = pose_matrices(seen["tcp_pose"]), pose_matrices(seen["base_pose"])
        openings = np.asarray(seen["agent_pos"]).reshape(len(hands), 7)[:, 6]
        memory = given.memory or _Memory(Progress.begin(hands, openings))
        progress, rows = go_on(memory.progress, bases, hands)
        ahead = memory.ahead
        if rows is None:
            if not (ahead and openings[ahead[0].robot] > FULL_M):
                _, ahead = next_key_poses(given.env.episode)
            key, ahead = ahead[0], ahead[1:]
            progress = set_out(progress, key, hands[max(0, key.robot)])
            progress, rows = go_on(progress, bases, hands)
        if rows is None:
            rows = held_still(progress, bases)
        return Actions(rows, _Memory(progress, ahead))


def held_still(progress: Progress, bases: Sequence[np.ndarray]) -> np.ndarray:
    from lemma.env.control.key_poses import commands

    return commands(np.repeat(progress.rows[None], 20, 0), bases)
