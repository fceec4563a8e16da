"""The expert as a policy at control level: its motion, as joint positions.

It shows that the level can be solved by actions of that kind. Before every sub-task it
takes a copy of the episode as it stands, lets the expert's skill act there, and answers
the joint angles that the servos were led to meanwhile, 20 a second, as one chunk.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.expert.expert import Expert
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Oracle

Rows = NDArray[np.float32]

_SETTLE_STEPS = 2
"""The servos get so long to arrive where the copy's have arrived."""
_WAIT_STEPS = 10


@dataclass(frozen=True, eq=False, kw_only=True)
class OracleControlInput(ControlInput):
    """What an oracle is given: the truth as well."""

    env: ControlEnv = field(repr=False)
    """The environment itself, with its simulation."""


class ExpertControl(Oracle):
    """Answers the motion of the expert's next sub-task."""

    control_options: ClassVar[Mapping[str, object]] = {
        "control": "joint_position",
        "control_hz": 20.0,
        "observation": "state",
    }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return a chunk of actions for each episode.

        Raises:
            InvalidConfigError: The inputs come without the truth.
        """
        return [self._act(given) for given in inputs]

    def _act(self, given: ControlInput) -> Actions:
        if not isinstance(given, OracleControlInput):
            raise InvalidConfigError("The expert is given no truth, but needs it.")
        copy = given.memory or Episode(given.env.instance)
        copy.restore(given.env.episode.snapshot())
        _, grounded = Expert(copy.simulation.scene, copy.instance.goal).act()
        if grounded is None:
            return Actions(np.stack([_row(copy)] * _WAIT_STEPS), copy)
        rows: list[Rows] = []
        every, ticks = given.env.config.ticks_per_step, 0

        def watch() -> None:
            nonlocal ticks
            ticks += 1
            if ticks % every == 0:
                rows.append(_row(copy))

        copy.simulation.observers.append(watch)
        copy.execute(grounded)
        copy.simulation.observers.remove(watch)
        rows += [_row(copy)] * _SETTLE_STEPS
        return Actions(_clipped(np.stack(rows), given.env), copy)


def _row(episode: Episode) -> Rows:
    """Return what all robots' servos follow now, (robots, 7) [rad, m]."""
    arms = episode.simulation.arms.values()
    return np.array([[*arm.state[0], arm.opening_m] for arm in arms], np.float32)


def _clipped(rows: Rows, env: ControlEnv) -> Rows:
    box = env.action_layout.box()
    clipped: Rows = np.clip(rows, box.low, box.high)
    return clipped
