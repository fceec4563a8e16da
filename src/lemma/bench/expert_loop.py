"""The expert's loop beside bare physics that repeat the same motor commands.

The loop is planning, grounding, skills, RMPflow and physics, from the first state of an
episode to its end. Beside it ``mj_step`` and nothing else goes from the same state with
the commands that the loop sent, and ends in the same state to the bit, so that both did
the same work. They take turns after every sub-task and are timed by what their thread
computes, so that their ratio says the same on a busy machine as on an idle one.
"""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import PhysicsError
from lemma.core.poses import FloatArray
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.scene.build import TIME_STEP_S
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance


@dataclass(frozen=True, slots=True)
class ExpertLoopFigures:
    """How fast the expert works, and how fast anybody could have.

    Times are medians of several turns of each sub-task, summed over the episodes.
    """

    expert_realtime: float
    """Simulated seconds of the expert's loop per second of its thread."""
    bare_realtime: float
    """The same of ``mj_step`` with the same motor commands."""
    ratio: float
    """The loop's over that of bare physics."""
    lowest_ratio: float
    """The ratio in the instance in which it is lowest."""


@dataclass(frozen=True, slots=True)
class RecordedLoop:
    """Motor commands of one episode of the expert."""

    start: FloatArray
    """The full integration state before the first step."""
    commands: FloatArray
    """Commands of every physics step, (n, nu)."""
    end: FloatArray
    """The state after the last."""
    simulated_s: float


def measure_expert_loop(
    instances: Iterable[Instance], turns: int = 5
) -> ExpertLoopFigures:
    """Measure the expert's loop and bare physics.

    Args:
        instances: The problems.
        turns: How often both do each instance.

    Raises:
        PhysicsError: The same commands did not lead to the same state.
    """
    found = []
    for instance in instances:
        # This warms up as well.
        recorded = record_loop(instance)
        times = np.array([time_loop(instance, recorded) for _ in range(turns)])
        loop_s, bare_s = np.median(times, axis=0).sum(axis=0).tolist()
        found.append((recorded.simulated_s, loop_s, bare_s))
    simulated, loop, bare = (sum(column) for column in zip(*found, strict=True))
    return ExpertLoopFigures(
        expert_realtime=simulated / loop,
        bare_realtime=simulated / bare,
        ratio=bare / loop,
        lowest_ratio=min(bare_s / loop_s for _, loop_s, bare_s in found),
    )


def record_loop(instance: Instance) -> RecordedLoop:
    """Let the expert solve an instance; record its motor commands."""
    episode = Episode(instance)
    scene = episode.simulation.scene
    start = scene.snapshot()
    commands: list[FloatArray] = []

    def note(_: mujoco.MjModel, data: mujoco.MjData) -> None:
        commands.append(data.ctrl.copy())

    mujoco.set_mjcb_control(note)
    try:
        for _ in solve(episode, Expert(scene, instance.goal)):
            pass
    finally:
        mujoco.set_mjcb_control(None)
    return RecordedLoop(start, np.array(commands), scene.snapshot(), scene.time_s)


def time_loop(instance: Instance, recorded: RecordedLoop) -> list[tuple[float, float]]:
    """Return how long the loop took for each sub-task, and bare physics [s].

    Args:
        instance: The problem.
        recorded: The expert's earlier run of it.

    Raises:
        PhysicsError: The same commands did not lead to the same state.
    """
    episode = Episode(instance)
    scene = episode.simulation.scene
    steps = solve(episode, Expert(scene, instance.goal))
    bare = Scene(instance.scene)
    bare.restore(recorded.start)
    model, data, done, times = bare.model, bare.data, 0, []
    control: FloatArray = data.ctrl
    going = True
    while going:
        start = time.thread_time()
        # The last turn finds that nothing is left to do, and stands still.
        going = next(steps, None) is not None
        middle = time.thread_time()
        until = round(scene.time_s / TIME_STEP_S)
        again = time.thread_time()
        for row in recorded.commands[done:until]:
            control[:] = row
            mujoco.mj_step(model, data)
        times.append((middle - start, time.thread_time() - again))
        done = until
    for ended in (scene, bare):
        if not np.array_equal(ended.snapshot(), recorded.end):
            raise PhysicsError(
                "The same motor commands from the same start led to another state. "
                "Physics are not repeatable on this machine."
            )
    return times
