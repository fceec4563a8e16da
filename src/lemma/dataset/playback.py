"""Replay of an episode: execution of its recorded steps without a policy.

The simulation is deterministic: on the same kind of machine, with the same versions,
the same steps lead to the same states, bit for bit.
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
from lemma.env.simulation import Simulation
from lemma.scene.build import TICK_S
from lemma.tasks.subtask import GroundedSubTask
from lemma.tasks.suite import FREE_SPLIT


@dataclass(frozen=True, slots=True)
class MotorCommands:
    """A sequence of actions at control level."""

    control: str
    """Control mode, a name in :data:`lemma.env.control.modes.CONTROLS`."""
    control_hz: float
    """Actions per second of simulated time."""
    rows: Sequence[NDArray[np.floating[Any]]]
    """Actions, oldest first, each (robots, columns)."""


Step = GroundedSubTask | MotorCommands
Watcher = Callable[[int], None]
"""Called with the index of each step before it begins, and with the number of steps
after the last one."""


def unwatched(number: int) -> None:
    """Do nothing: the default watcher."""


def play_steps(
    episode: Episode,
    steps: Iterable[Step],
    before: Watcher = unwatched,
    *,
    lingers: bool = False,
) -> None:
    """Execute steps, one after another.

    Outcomes of sub-tasks are in ``episode.executed``. Add observers of every tick to
    ``episode.simulation.observers``.

    Args:
        episode: The episode, in its initial state. Afterwards it is over only if its
            time is up.
        steps: The recorded steps.
        before: Called before each step.
        lingers: Whether every sub-task takes at least the least time of a policy's
            decision.

    Raises:
        LemmaError: A step cannot be executed, or the episode is over before it.
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
    """Execute a step from the present state, to its end or that of the episode.

    Raises:
        LemmaError: The step cannot be executed, or the episode is over.
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
    """Records the joint positions of a simulation at a rate."""

    def __init__(
        self,
        simulation: Simulation,
        frame_s: float,
        frames: Iterable[tuple[float, FloatArray]] = (),
    ) -> None:
        """Begin to record.

        Args:
            simulation: The simulation; it is not changed.
            frame_s: Simulated time from one state to the next [s].
            frames: Recorded times and states of an earlier part of the episode.
        """
        self._simulation, self._frame_s = simulation, frame_s
        self.frames = [*frames]
        """Simulated times [s] and MuJoCo's joint positions, (nq,)."""
        self._take()
        simulation.observers.append(self._take)

    def _take(self) -> None:
        time_s = self._simulation.time_s
        if time_s >= len(self.frames) * self._frame_s - 0.5 * TICK_S:
            self.frames.append((time_s, self._simulation.scene.data.qpos.copy()))
