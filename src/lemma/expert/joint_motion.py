"""The expert's motion as joint positions, for the control level.

Before every sub-task a copy of the episode takes its present state, the expert's skill
acts in the copy, and the joint angles that the servos were led to there become actions.
A difference from the copy is seen before the next sub-task.
"""

import numpy as np
from numpy.typing import NDArray

from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.expert.expert import Expert

Rows = NDArray[np.float32]

MODE = "joint_position"
"""The control mode whose actions these are."""
_SETTLE_STEPS = 2
"""The servos get so long to arrive where those of the copy have arrived."""
_WAIT_STEPS = 10


class JointMotion:
    """Turns the expert's sub-tasks in one episode into actions."""

    def __init__(self, env: ControlEnv) -> None:
        """Make the copy.

        Args:
            env: In an episode, in control mode :data:`MODE`.
        """
        self._env = env
        self._copy = Episode(env.instance)

    def next_chunk(self) -> Rows:
        """Return the actions of the next sub-task, (steps, robots, 7) [rad, m].

        Where nothing is left to do, or nothing can be done, all stays where it is.
        """
        copy, env = self._copy, self._env
        copy.restore(env.episode.snapshot())
        _, grounded = Expert(copy.simulation.scene, copy.instance.goal).act()
        rows: list[Rows] = []
        ticks = 0

        def watch() -> None:
            nonlocal ticks
            ticks += 1
            if ticks % env.config.ticks_per_step == 0:
                rows.append(_row(copy))

        if grounded is not None:
            copy.simulation.observers.append(watch)
            copy.execute(grounded)
            copy.simulation.observers.remove(watch)
        rows += [_row(copy)] * (_WAIT_STEPS if grounded is None else _SETTLE_STEPS)
        box = env.action_layout.box()
        found: Rows = np.clip(np.stack(rows), box.low, box.high)
        return found


def _row(episode: Episode) -> Rows:
    """Return what all robots' servos follow now, (robots, 7) [rad, m]."""
    arms = episode.simulation.arms.values()
    return np.array([[*arm.state[0], arm.opening_m] for arm in arms], np.float32)
