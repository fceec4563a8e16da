"""Measurements of `lemma bench` of speed and memory, by name.

Measurements relative to bare physics alternate with it, from the same states, in thread
time. So the ratio does not depend on the load of the machine.
"""

import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import PhysicsError
from lemma.core.poses import FloatArray
from lemma.core.robot_names import robot_names
from lemma.core.workers.pool import ProcessPool
from lemma.core.workers.resources import peak_memory_mb
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.expert.expert import ExpertStep, solve
from lemma.scene.build import TIME_STEP_S
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.scene.topdown_map import fuse
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, TASKS
from lemma.viz.map_overlay import camera_images
from lemma.viz.recording import record

Figures = dict[str, float]
"""Numbers by their names in JSON; `lemma bench` describes each."""

Play = Callable[[Episode], Iterator[ExpertStep]]
"""Solves an episode, sub-task by sub-task."""

HZ = 20.0
"""Control steps per simulated second."""
IMAGE_SIZE = (320, 240)
_KEPT_STEPS = 7
"""Number of control steps with the same random action."""


def measure_speed(instances: Sequence[Instance], repeats: int = 30) -> Figures:
    """Measure episodes without images, images, sampling, resets and memory.

    Args:
        instances: Episodes to run; use several tasks, because their speeds differ.
        repeats: Number of timings of short operations.
    """
    record(instances[0], horizon_s=2.0)
    recordings = [record(instance) for instance in instances]
    simulated = sum(recording.elapsed_s for recording in recordings)
    renderer = Renderer()
    state_s, images_s = _time_resets(instances, renderer, repeats)
    (peak_mb,) = ProcessPool(1).run(_peak_mb_of_episode, [(instances[-1],)])
    return {
        "realtime_factor": simulated / sum(r.wall_s for r in recordings),
        **_measure_images(instances[0], renderer, repeats),
        "sample_ms": 1e3 * _time_sampling({one.task for one in instances}),
        "reset_state_ms": 1e3 * state_s,
        "reset_images_ms": 1e3 * images_s,
        "peak_mb": peak_mb,
    }


def _time_sampling(tasks: Iterable[str], each: int = 10) -> float:
    """Return the time to sample an instance, including rejected candidates [s]."""
    records = [TASKS[task] for task in sorted(tasks)]
    # A warm-up, which compiles kernels and computes reach.
    sample(records[0], FREE_SPLIT, each)
    start = time.perf_counter()
    for task in records:
        for index in range(each):
            sample(task, FREE_SPLIT, index)
    return (time.perf_counter() - start) / (each * len(records))


def _measure_images(instance: Instance, renderer: Renderer, repeats: int) -> Figures:
    scene = Episode(instance).simulation.scene
    images = camera_images(scene, renderer)
    fuse(images)
    look_s = _median_s(lambda: camera_images(scene, renderer), repeats)
    map_s = _median_s(lambda: fuse(images), repeats)
    return {"camera_fps": len(images) / look_s, "map_ms": 1e3 * map_s}


def _time_resets(
    instances: Sequence[Instance], renderer: Renderer, repeats: int
) -> tuple[float, float]:
    """Return the times to the first state, and to the first images [s]."""
    times = []
    for i in range(repeats):
        start = time.perf_counter()
        scene = Episode(instances[i % len(instances)]).simulation.scene
        middle = time.perf_counter()
        camera_images(scene, renderer)
        times.append((middle - start, time.perf_counter() - start))
    state_s, images_s = np.median(times, axis=0).tolist()
    return state_s, images_s


def _peak_mb_of_episode(instance: Instance) -> float:
    """Return the peak memory of an episode in a new process [MB]."""
    episode = Episode(instance)
    renderer = Renderer()
    scene = episode.simulation.scene
    fuse(camera_images(scene, renderer))
    for _ in solve(episode):
        fuse(camera_images(scene, renderer))
    return peak_memory_mb()


def _median_s(work: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def measure_control(instance: Instance, steps: int = 200) -> Figures:
    """Measure the control level with random actions.

    Args:
        instance: The instance.
        steps: Number of control steps of each measurement; a fifth of it with images.
    """
    angles, bare = _time_steps(instance, steps, "joint_position")
    poses, bare_poses = _time_steps(instance, steps, "ee_pose")
    rgbd, _ = _time_steps(instance, max(1, steps // 5), "joint_position", "rgbd")
    return {
        "bare_physics_hz": 1.0 / float(np.median(bare)),
        "joint_position_hz": 1.0 / float(np.median(angles)),
        "joint_position_ratio": float(np.median(bare / angles)),
        "ee_pose_hz": 1.0 / float(np.median(poses)),
        "ee_pose_ratio": float(np.median(bare_poses / poses)),
        "rgbd_hz": 1.0 / float(np.median(rgbd)),
    }


def _time_steps(
    instance: Instance, steps: int, control: str, observation: str = "state"
) -> tuple[FloatArray, FloatArray]:
    """Return the time of each step, and of bare physics from the same state [s]."""
    width, height = IMAGE_SIZE
    config = EnvConfig(
        task=instance.task,
        control=control,
        control_hz=HZ,
        observation=observation,
        width=width,
        height=height,
        cameras=robot_names(len(instance.scene.robots)),
    )
    env = ControlEnv(config)
    env.reset(options={"instance": instance})
    rng, layout = np.random.default_rng(0), env.action_layout
    scene = env.episode.simulation.scene
    spare = mujoco.MjData(scene.model)
    times: list[tuple[float, float]] = []
    # Thread time does not depend on the load, but excludes the threads of OpenGL.
    clock = time.thread_time if observation == "state" else time.perf_counter
    # The first warms up.
    for step in range(steps + 1):
        if step % _KEPT_STEPS == 0:
            action = rng.uniform(layout.low, layout.high, layout.shape)
        mujoco.mj_copyData(spare, scene.model, scene.data)
        start = clock()
        for _ in range(round(1.0 / HZ / TIME_STEP_S)):
            mujoco.mj_step(scene.model, spare)
        middle = clock()
        env.step(action)
        times.append((clock() - middle, middle - start))
    env.close()
    found = np.array(times[1:])
    return found[:, 0], found[:, 1]


class RecordedLoop(NamedTuple):
    """Motor commands of one episode of the expert."""

    start: FloatArray
    """The full integration state before the first step."""
    commands: FloatArray
    """Commands of every physics step, (n, nu)."""
    end: FloatArray
    """The state after the last physics step."""
    simulated_s: float


def measure_expert_loop(instances: Iterable[Instance], turns: int = 5) -> Figures:
    """Measure the expert's loop and bare physics with the same motor commands.

    The loop is planning, grounding, skills, RMPflow and physics, from the first state
    of an episode to its end. For comparison, ``mj_step`` alone runs with the recorded
    commands, and must end in the same state to the bit. Times are medians over several
    runs of each sub-task, summed over the episodes.

    Args:
        instances: The instances.
        turns: Number of runs of each instance.

    Raises:
        PhysicsError: The same commands led to another state.
    """
    found = [median_times_s(instance, turns, solve) for instance in instances]
    simulated, loop, bare = (sum(column) for column in zip(*found, strict=True))
    return {
        "expert_realtime": simulated / loop,
        "bare_realtime": simulated / bare,
        "ratio": bare / loop,
        "lowest_ratio": min(bare_s / loop_s for _, loop_s, bare_s in found),
    }


def median_times_s(
    instance: Instance, turns: int, play: Play
) -> tuple[float, float, float]:
    """Return an episode's simulated time, and times of loop and bare physics [s]."""
    # The recording is also the warm-up.
    recorded = record_loop(instance, play)
    times = [time_loop(instance, recorded, play) for _ in range(turns)]
    loop_s, bare_s = np.median(times, axis=0).sum(axis=0).tolist()
    return recorded.simulated_s, loop_s, bare_s


def record_loop(instance: Instance, play: Play = solve) -> RecordedLoop:
    """Solve an instance with the expert, and record its motor commands.

    Args:
        instance: The instance.
        play: Solves the episode.
    """
    episode = Episode(instance)
    scene = episode.simulation.scene
    start = scene.snapshot()
    commands: list[FloatArray] = []

    def note(_: mujoco.MjModel, data: mujoco.MjData) -> None:
        commands.append(data.ctrl.copy())

    mujoco.set_mjcb_control(note)
    try:
        for _ in play(episode):
            pass
    finally:
        mujoco.set_mjcb_control(None)
    return RecordedLoop(start, np.array(commands), scene.snapshot(), scene.time_s)


def time_loop(
    instance: Instance, recorded: RecordedLoop, play: Play = solve
) -> list[tuple[float, float]]:
    """Return the times of the loop and of bare physics for each sub-task [s].

    Args:
        instance: The instance.
        recorded: The recorded run of it.
        play: Solves the episode, as in the recorded run.

    Raises:
        PhysicsError: The same commands led to another state.
    """
    episode = Episode(instance)
    scene = episode.simulation.scene
    steps = play(episode)
    bare = Scene(instance.scene)
    bare.restore(recorded.start)
    model, data, done, times = bare.model, bare.data, 0, []
    control: FloatArray = data.ctrl
    going = True
    while going:
        start = time.thread_time()
        # In the last iteration the goal holds, and the robots rest.
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
