"""The figures of `lemma bench`: how fast it is, how much memory, how good the expert.

Every figure has one function, which returns plain numbers.
"""

import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass

from lemma.bench.control import ControlFigures
from lemma.bench.expert_loop import ExpertLoopFigures
from lemma.core.workers.pool import ProcessPool, run_in_order
from lemma.core.workers.resources import peak_memory_mb
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.scene.cameras import CameraImage
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.scene.topdown_map import fuse
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, TASKS, load_instance
from lemma.viz.recording import record


@dataclass(frozen=True, slots=True)
class Speed:
    """How fast the benchmark runs on this machine."""

    realtime_factor: float
    """Simulated seconds per second, expert episodes without images, on one core."""
    camera_fps: float
    """Camera pictures per second, 640 x 480, color and depth together."""
    map_ms: float
    """Fusing two cameras into the top-down map."""
    sample_ms: float
    """Sampling a new instance, mean over the tasks."""
    reset_state_ms: float
    """From an instance to its first state."""
    reset_images_ms: float
    """From an instance to its first state and the pictures of both cameras."""
    peak_mb: float
    """Largest memory of a process that solves one instance, with cameras and maps."""


@dataclass(frozen=True, slots=True)
class ExpertFigures:
    """How the expert does at one task."""

    episodes: int
    """Frozen instances, and as many freshly sampled ones."""
    success_rate: float
    """On the frozen instances."""
    raw_success_rate: float
    """On fresh ones, before any filter that keeps only what the expert solves."""
    mean_sim_s: float
    """Mean simulated time of the frozen instances [s]."""
    max_sim_s: float
    """Longest simulated time of the frozen instances [s]."""
    rejection_rate: float
    """Part of all tables set that the sampler refused, for the fresh instances."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One instance that the expert worked on."""

    task: str
    fresh: bool
    """Whether it was sampled for this, or comes from a frozen list."""
    success: bool
    simulated_s: float
    rejected: int
    """Tables that the sampler refused before it."""


def measure_speed(instances: list[Instance], repeats: int = 30) -> Speed:
    """Measure everything but the expert's success.

    Args:
        instances: Episodes to run; what is fast in one task is slow in another.
        repeats: How often to time what takes milliseconds.
    """
    record(instances[0], horizon_s=2.0)
    renderer = Renderer()
    fps, map_ms = measure_images(instances[0], renderer, repeats)
    state_ms, images_ms = measure_reset(instances, renderer, repeats)
    return Speed(
        realtime_factor=measure_realtime_factor(instances),
        camera_fps=fps,
        map_ms=map_ms,
        sample_ms=measure_sampling([instance.task for instance in instances]),
        reset_state_ms=state_ms,
        reset_images_ms=images_ms,
        peak_mb=measure_peak_mb(instances[-1]),
    )


def measure_sampling(tasks: list[str], each: int = 10) -> float:
    """Return milliseconds to sample an instance, tables that are rejected included.

    Args:
        tasks: Names of tasks, in any number.
        each: Instances of each task.
    """
    records = [TASKS[task] for task in dict.fromkeys(tasks)]
    # The first has kernels compiled and reach computed.
    sample(records[0], FREE_SPLIT, each)
    start = time.perf_counter()
    for task in records:
        for index in range(each):
            sample(task, FREE_SPLIT, index)
    return 1000.0 * (time.perf_counter() - start) / (each * len(records))


def measure_realtime_factor(instances: Iterable[Instance]) -> float:
    """Return simulated time over real time of whole expert episodes."""
    recordings = [record(instance) for instance in instances]
    simulated = sum(recording.elapsed_s for recording in recordings)
    return simulated / sum(recording.wall_s for recording in recordings)


def measure_images(
    instance: Instance, renderer: Renderer, repeats: int
) -> tuple[float, float]:
    """Return camera pictures per second, and milliseconds per fused map."""
    scene = Episode(instance).simulation.scene
    images = _look(scene, renderer)
    fuse(images)
    look_ms = _median_ms(lambda: _look(scene, renderer), repeats)
    map_ms = _median_ms(lambda: fuse(images), repeats)
    return 1000.0 * len(images) / look_ms, map_ms


def measure_reset(
    instances: list[Instance], renderer: Renderer, repeats: int
) -> tuple[float, float]:
    """Return milliseconds to a first state, and to the first pictures."""
    state_ms, images_ms = [], []
    for i in range(repeats):
        instance = instances[i % len(instances)]
        start = time.perf_counter()
        scene = Episode(instance).simulation.scene
        middle = time.perf_counter()
        _look(scene, renderer)
        end = time.perf_counter()
        state_ms.append(1000.0 * (middle - start))
        images_ms.append(1000.0 * (end - start))
    return statistics.median(state_ms), statistics.median(images_ms)


def measure_peak_mb(instance: Instance) -> float:
    """Return the peak memory of a new process that does all an environment does."""
    (peak_mb,) = ProcessPool(1).run(_peak_mb_of_episode, [(instance,)])
    return float(peak_mb)


def _peak_mb_of_episode(instance: Instance) -> float:
    episode = Episode(instance)
    renderer = Renderer()
    scene = episode.simulation.scene
    fuse(_look(scene, renderer))
    for _ in solve(episode, Expert(scene, instance.goal)):
        fuse(_look(scene, renderer))
    return peak_memory_mb()


def run_trials(tasks: Iterable[str], episodes: int, workers: int) -> Iterator[Trial]:
    """Let the expert work on frozen and on fresh instances, in several processes.

    Args:
        tasks: Names of the tasks.
        episodes: Instances per task and kind.
        workers: Processes.

    Yields:
        The trials, in a fixed order.
    """
    jobs = [
        (task, fresh, index)
        for task in tasks
        for fresh in (False, True)
        for index in range(episodes)
    ]
    yield from run_in_order(ProcessPool(workers), run_trial, jobs)


def run_trial(task: str, fresh: bool, index: int) -> Trial:
    """Let the expert work on one instance.

    Args:
        task: Name of the task.
        fresh: Whether to sample it, instead of taking it from the frozen list.
        index: Number of the instance.
    """
    rejected = 0
    if fresh:
        drawn = sample(TASKS[task], FREE_SPLIT, index)
        instance, rejected = drawn.instance, drawn.rejected
    else:
        instance = load_instance(task, "test", index)
    done = record(instance)
    return Trial(task, fresh, done.success, done.elapsed_s, rejected)


def expert_figures(trials: Iterable[Trial]) -> dict[str, ExpertFigures]:
    """Return the figures of every task that occurs in the trials."""
    by_task: dict[str, tuple[list[Trial], list[Trial]]] = {}
    for trial in trials:
        by_task.setdefault(trial.task, ([], []))[trial.fresh].append(trial)
    figures = {}
    for task, (frozen, fresh) in by_task.items():
        refused = sum(trial.rejected for trial in fresh)
        figures[task] = ExpertFigures(
            episodes=len(frozen),
            success_rate=statistics.fmean(trial.success for trial in frozen),
            raw_success_rate=statistics.fmean(trial.success for trial in fresh),
            mean_sim_s=statistics.fmean(trial.simulated_s for trial in frozen),
            max_sim_s=max(trial.simulated_s for trial in frozen),
            rejection_rate=refused / (refused + len(fresh)),
        )
    return figures


def _look(scene: Scene, renderer: Renderer) -> list[CameraImage]:
    scene.refresh()
    return [
        renderer.rgbd(scene.model, scene.data, f"{name}/camera")
        for name in scene.spec.robot_names
    ]


def _median_ms(work: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1000.0 * statistics.median(times)


def rounded(
    figures: Speed | ExpertLoopFigures | ControlFigures | ExpertFigures,
) -> dict[str, float]:
    """Return figures as plain data with three decimals, ready for JSON."""
    return {name: round(value, 3) for name, value in asdict(figures).items()}
