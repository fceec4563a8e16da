"""An attack that succeeded, replayed from what it did, with states for a video."""

import time
from collections.abc import Iterator

import numpy as np

from lemma.audit.attack import ATTACKS
from lemma.audit.control_trial import control_config
from lemma.audit.run import Found
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.simulation import TICK_S
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import Primitive, SubTask
from lemma.viz.recording import RecordedStep, Recording, robot_titles

_Step = tuple[str, float, float]
"""What is done, when it begins and how long it takes [s]."""


def replay_attack(found: Found, instance: Instance, frame_s: float) -> Recording:
    """Do again what an attack did.

    Args:
        found: What it did; it must have succeeded.
        instance: To what.
        frame_s: Simulated time from one frame to the next [s].

    Raises:
        InvalidConfigError: The attack did not succeed, so it was not kept what it did.
    """
    if not found.succeeded:
        raise InvalidConfigError(
            f"The attack {found.attack} on {instance.key} did not succeed, so there is "
            "nothing to replay."
        )
    started = time.perf_counter()
    player = _Skills(instance) if found.commands is None else _Commands(instance)
    simulation = player.episode.simulation
    frames: list[tuple[float, FloatArray]] = []

    def take_frame() -> None:
        if simulation.time_s >= len(frames) * frame_s - 0.5 * TICK_S:
            frames.append((simulation.time_s, simulation.scene.snapshot()))

    take_frame()
    simulation.observers.append(take_frame)
    steps = tuple(_described(found, instance, *step) for step in player.replayed(found))
    return Recording(
        instance=instance,
        steps=steps,
        frames=tuple(frames),
        success=player.success,
        failure=None if player.success else "goal_not_reached",
        elapsed_s=simulation.time_s,
        wall_s=time.perf_counter() - started,
    )


class _Skills:
    """Replays grounded sub-tasks."""

    def __init__(self, instance: Instance) -> None:
        self.episode = Episode(instance)

    def replayed(self, found: Found) -> Iterator[_Step]:
        episode = self.episode
        for subtask in found.subtasks:
            start_s = episode.elapsed_s
            episode.execute(subtask)
            episode.linger(start_s)
            yield str(subtask.primitive), start_s, episode.elapsed_s - start_s
        if not episode.is_over:
            episode.stop()

    @property
    def success(self) -> bool:
        return self.episode.is_success


class _Commands:
    """Replays motor commands."""

    def __init__(self, instance: Instance) -> None:
        self._env = ControlEnv(control_config(instance.task))
        self._env.set_table(options={"instance": instance})
        self.episode = self._env.episode
        self.success = False

    def replayed(self, found: Found) -> Iterator[_Step]:
        commands = np.zeros((0, 0, 0)) if found.commands is None else found.commands
        for action in commands:
            self.success = self._env.advance(action)[0] > 0.0
        yield "motor commands", 0.0, self.episode.elapsed_s


def _described(
    found: Found, instance: Instance, what: str, start_s: float, duration_s: float
) -> RecordedStep:
    number = instance.scene.robot_names.index(found.robot)
    title = robot_titles(instance)[number]
    summary = ATTACKS[found.attack].summary
    return RecordedStep(
        robot=title,
        subtask=SubTask(found.robot, Primitive.MOVE),
        words=f"{title} alone, {what}. {summary}",
        outcome="success",
        explanation="",
        ok=True,
        start_s=start_s,
        duration_s=duration_s,
    )
