"""Motions of policies at control level from one key pose to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lemma.core.poses import FloatArray
from lemma.env.control.key_poses import (
    CONTROL,
    CONTROL_HZ,
    FULL_M,
    KeyPose,
    Progress,
    Rows,
    go_on,
    pose_matrices,
    set_out,
    stay,
)
from lemma.policies.control.interfaces import Actions, ControlInput

KEY_POSE_OPTIONS: Mapping[str, object] = {
    "control": CONTROL,
    "control_hz": CONTROL_HZ,
    "clip_actions": True,
}
"""Options of the environment of such policies, except the observation."""


@dataclass(frozen=True, eq=False)
class Moving:
    """State of an episode in which arms move from one key pose to the next."""

    progress: Progress
    rows: Rows | None
    """The next waypoints; None if there is no further key pose."""
    bases: list[FloatArray]
    """World from base of each robot, (4, 4)."""
    hands: list[FloatArray]
    """World from tool center point of each robot, (4, 4)."""
    openings: FloatArray
    """Openings of the grippers [m], (robots,)."""

    @classmethod
    def of(cls, control_input: ControlInput, progress: Progress | None) -> "Moving":
        """Continue a motion.

        Args:
            control_input: Input of a policy.
            progress: Progress so far; None at the beginning of an episode.
        """
        seen = control_input.observation
        hands, bases = pose_matrices(seen["tcp_pose"]), pose_matrices(seen["base_pose"])
        openings = np.asarray(seen["agent_pos"], float).reshape(len(hands), 7)[:, 6]
        if progress is None:
            progress = Progress.begin(hands, openings)
        progress, rows = go_on(progress, bases, hands)
        return cls(progress, rows, bases, hands, openings)

    def towards(self, key: KeyPose) -> "Moving":
        """Begin the motion to a key pose."""
        progress = set_out(self.progress, key, self.hands[max(0, key.robot)])
        progress, rows = go_on(progress, self.bases, self.hands)
        return replace(self, progress=progress, rows=rows)

    def holds(self, robot: int) -> bool:
        """Return whether a closed hand holds an object."""
        return bool(self.openings[robot] > FULL_M)

    def actions(self, memory: Any) -> Actions:
        """Return the output of a policy: the next waypoints, or a pause.

        Args:
            memory: Memory of the policy.
        """
        rows = stay(self.progress, self.bases) if self.rows is None else self.rows
        return Actions(rows, memory)
