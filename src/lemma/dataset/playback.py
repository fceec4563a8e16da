"""An episode played again: recorded steps are carried out, and nobody decides.

Physics repeats to the bit, so the same steps lead to the same states on the same kind
of machine, with the same versions.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.simulation import TICK_S, Simulation
from lemma.tasks.subtask import GroundedSubTask
from lemma.tasks.suite import FREE_SPLIT


@dataclass(frozen=True, slots=True)
class MotorCommands:
    """Actions at control level, one after the other."""

    control: str
    """Their mode, a name in :data:`lemma.env.control.modes.CONTROLS`."""
    control_hz: float
    """Actions per second of simulated time."""
    rows: Sequence[NDArray[np.floating[Any]]]
    """Actions, oldest first, each (robots, columns)."""


Step = GroundedSubTask | MotorCommands
Watcher = Callable[[int], None]
"""Is told of each step, from 0, before it begins, and once more behind the last one."""


def unwatched(number: int) -> None:
    """Take no notice."""


def play_steps(
    episode: Episode,
    steps: Iterable[Step],
    before: Watcher = unwatched,
    *,
    lingers: bool = False,
) -> None:
    """Carry out steps, one after the other.

    Outcomes of sub-tasks are in ``episode.executed``. Observers of every tick are added
    to ``episode.simulation.observers``.

    Args:
        episode: Just begun; at the end it is over only if the time is up.
        steps: Recorded steps to carry out.
        before: Is told of each step.
        lingers: Whether every sub-task takes as long as a decision of a policy does at
            least.

    Raises:
        LemmaError: A step is impossible, or the episode is over before it.
    """
    done = 0
    for step in steps:
        before(done)
        start_s = episode.elapsed_s
        carry_out(episode, step)
        if lingers:
            episode.linger(start_s)
        done += 1
    before(done)


def carry_out(episode: Episode, step: Step) -> None:
    """Carry out a step from where the robots are, to its end or that of the episode.

    Raises:
        LemmaError: It is impossible, or the episode is over.
    """
    if isinstance(step, GroundedSubTask):
        episode.execute(step)
        return
    config = EnvConfig(
        task=episode.instance.task,
        split=FREE_SPLIT,
        control=step.control,
        control_hz=step.control_hz,
    )
    env = ControlEnv(config)
    env.take_over(episode)
    for row in step.rows:
        if episode.is_over:
            break
        env.advance(row)


class FrameTaker:
    """Keeps positions of all joints at a rate, while a simulation goes on."""

    def __init__(
        self,
        simulation: Simulation,
        frame_s: float,
        frames: Iterable[tuple[float, FloatArray]] = (),
    ) -> None:
        """Watch a simulation from now on.

        Args:
            simulation: It is not changed.
            frame_s: Simulated time from one state to the next [s].
            frames: States kept from an earlier part of the episode, with their times.
        """
        self._simulation, self._frame_s = simulation, frame_s
        self.frames = [*frames]
        """Simulated time [s] and positions of all joints, (nq,)."""
        self._take()
        simulation.observers.append(self._take)

    def _take(self) -> None:
        time_s = self._simulation.time_s
        if time_s >= len(self.frames) * self._frame_s - 0.5 * TICK_S:
            self.frames.append((time_s, self._simulation.scene.data.qpos.copy()))
