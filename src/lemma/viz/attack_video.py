"""An attack that succeeded, played again for a video."""

import time
from itertools import pairwise

from lemma.audit.attack import ATTACKS
from lemma.audit.control_trial import control_config
from lemma.audit.run import Found
from lemma.core.errors import InvalidConfigError
from lemma.dataset.playback import FrameTaker, MotorCommands, Step, play_steps
from lemma.env.episode import Episode
from lemma.tasks.instance import Instance
from lemma.viz.recording import Line, Recording, robot_titles


def replay_attack(found: Found, instance: Instance, frame_s: float) -> Recording:
    """Play an attack again.

    Args:
        found: The attack's record; it must have succeeded.
        instance: That was attacked.
        frame_s: Simulated time from one frame to the next [s].

    Raises:
        InvalidConfigError: The attack did not succeed, so its actions were not kept.
    """
    if not found.succeeded:
        raise InvalidConfigError(
            f"The attack {found.attack} on {instance.key} did not succeed, so there is "
            "nothing to replay."
        )
    started = time.perf_counter()
    episode = Episode(instance)
    simulation = episode.simulation
    taker = FrameTaker(simulation, frame_s)
    commands = found.commands
    times: list[float] = []
    what = [str(subtask.primitive) for subtask in found.subtasks]
    steps: list[Step] = [*found.subtasks]
    if commands is not None:
        config = control_config(instance.task)
        what = ["motor commands"]
        steps = [MotorCommands(config.control, config.control_hz, list(commands))]
    play_steps(
        episode,
        steps,
        lambda number: times.append(episode.elapsed_s),
        lingers=commands is None,
    )
    if commands is None and not episode.is_over:
        episode.stop()
    success = episode.is_success
    return Recording(
        title=found.attack,
        instance=instance,
        lines=tuple(
            _line(found, instance, name, start_s, end_s)
            for name, (start_s, end_s) in zip(what, pairwise(times), strict=True)
        ),
        frames=tuple(taker.frames),
        success=success,
        failure=None if success else "goal_not_reached",
        elapsed_s=simulation.time_s,
        wall_s=time.perf_counter() - started,
    )


def _line(
    found: Found, instance: Instance, what: str, start_s: float, end_s: float
) -> Line:
    number = instance.scene.robot_names.index(found.robot)
    title = robot_titles(instance)[number]
    words = f"{title} alone, {what}. {ATTACKS[found.attack].summary}"
    return Line(words, start_s, end_s, "success")
