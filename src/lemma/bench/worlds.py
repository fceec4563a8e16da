"""Speed of many worlds on a GPU with and without CUDA graphs, and their equality.

The module imports torch and MuJoCo Warp, which are optional dependencies.
"""

import time
from collections.abc import Callable
from typing import Any

import torch
import warp as wp
from torch import Tensor

from lemma.warp.vector_env import GpuVecEnv

CONTROL_HZ = 20.0
Figures = dict[str, float]


def describe_device() -> dict[str, Any]:
    """Return the device of the simulation, ready for JSON."""
    if not torch.cuda.is_available():
        return {"device": "cpu", "torch": torch.__version__, "warp": wp.__version__}
    return {
        "device": torch.cuda.get_device_name(),
        "device_memory_gb": round(torch.cuda.mem_get_info()[1] / 1e9, 1),
        "cuda": torch.version.cuda,
        "torch": torch.__version__,
        "warp": wp.__version__,
    }


def measure_worlds(
    task: str, worlds: int, steps: int | None = None, **options: Any
) -> dict[str, Any]:
    """Measure speed at 20 Hz with random actions, and compare both paths.

    Args:
        task: Name of a task with cubes and pads.
        worlds: Number of worlds.
        steps: Number of timed control steps, after a warm-up; if None, 200 on a GPU, 5
            on a CPU.
        **options: Options of :class:`lemma.warp.vector_env.GpuVecEnv`.

    Returns:
        ``eager_hz``, ``graph_hz`` and ``physics_hz``, control steps per second of all
        worlds, the last for the physics of these steps alone; ``outside`` and
        ``eager_outside``, the share of time outside of the physics; ``graphed``,
        ``differences`` of :func:`compare`, ``lost_worlds``, ``ready_s``.
    """
    start = time.perf_counter()
    steps = steps or (200 if torch.cuda.is_available() else 5)
    options = {"pool": 64, "control_hz": CONTROL_HZ, **options}
    env = GpuVecEnv(task, worlds, graph=False, **options)
    # Random ages, so that episodes end at different times.
    env._age.random_(0, env._horizon)
    _play(env, 2)
    found: dict[str, Any] = {"ready_s": time.perf_counter() - start}
    eager, eager_physics = _in_play(env, steps)
    start = time.perf_counter()
    env.use_graph(True)
    env._age.random_(0, env._horizon)
    _play(env, 2)
    found["capture_s"] = time.perf_counter() - start
    whole, physics = _in_play(env, steps)
    parts = {
        "before_ms": 1e3 * _timed(env, steps, env._before),
        "after_ms": 1e3 * _timed(env, steps, env._after),
    }
    return found | {
        "worlds": worlds,
        "graphed": env.graphed,
        "eager_hz": worlds / eager,
        "graph_hz": worlds / whole,
        "physics_hz": worlds / physics,
        "step_ms": 1e3 * whole,
        "physics_ms": 1e3 * physics,
        **parts,
        "outside": 1.0 - physics / whole,
        "eager_outside": 1.0 - eager_physics / eager,
        "differences": compare(env, min(steps, 20)),
        "lost_worlds": int(env.lost_worlds),
    }


def measure_pictures(
    task: str, worlds: int, steps: int | None = None, **options: Any
) -> dict[str, Any]:
    """Measure RGB-D images of the robots' close cameras, by default 128 x 128 pixels.

    Args:
        task: Name of a task with cubes and pads.
        worlds: Number of worlds.
        steps: Number of timed observations; if None, 50 on a GPU, 2 on a CPU.
        **options: Options of :class:`lemma.warp.vector_env.GpuVecEnv`.

    Returns:
        ``images_hz``, images with color and depth per second, without physics;
        ``rgbd_hz``, control steps per second of all worlds, with images at each step.
    """
    steps = steps or (50 if torch.cuda.is_available() else 2)
    options = {"pool": 64, "control_hz": CONTROL_HZ, **options}
    env = GpuVecEnv(task, worlds, observation="rgbd", **options)
    assert env.pictures is not None
    _play(env, 2)
    look = _timed(env, steps, env.pictures.look)
    whole = _timed(env, steps, lambda: _play(env, 1))
    cameras = len(env.pictures.cameras)
    return {
        "images_hz": worlds * cameras / look,
        "rgbd_hz": worlds / whole,
        "look_ms": 1e3 * look,
        "cameras": cameras,
    }


def compare(env: GpuVecEnv, steps: int) -> Figures:
    """Return the largest differences of the eager and the graph path.

    At every step both paths compute the commands, and then the results of the physics,
    from the same states.

    Args:
        env: The environment; its episodes continue.
        steps: Number of compared steps.

    Returns:
        Largest differences by name of a step's result, ``memory`` and ``commands``; 1
        if a boolean or an instance's index differs.
    """
    worst: Figures = {}
    for _ in range(steps):
        env._action.uniform_(-1.0, 1.0)
        _compare(env, env._command, env._before, "commands", worst)
        env._simulate()
        _compare(env, env._judge, env._after, "memory", worst)
    env.check()
    return worst


def _compare(
    env: GpuVecEnv,
    plain: Callable[[], Any],
    replayed: Callable[[], Any],
    name: str,
    worst: Figures,
) -> None:
    memory = env._mutable()
    before = [one.clone() for one in memory]
    ends = []
    for work in (plain, replayed):
        for one, value in zip(memory, before, strict=True):
            one.copy_(value)
        with torch.no_grad():
            outputs = work() or {}
        flat = {**outputs, **outputs.get("observation", {})}
        end = {key: flat[key].clone() for key in flat if key not in _NESTED}
        end |= {f"{name} {i}": one.clone() for i, one in enumerate(memory)}
        ends.append(end)
    for key, value in ends[0].items():
        short = name if key.startswith(name) else key
        worst[short] = max(worst.get(short, 0.0), _difference(value, ends[1][key]))


_NESTED = ("observation", "final_obs")


def _difference(a: Tensor, b: Tensor) -> float:
    if not a.is_floating_point():
        return float((a != b).any())
    return float((a - b).abs().nan_to_num(0.0, 0.0).max())


def _play(env: GpuVecEnv, steps: int) -> None:
    for _ in range(steps):
        env.step(torch.rand_like(env._action).mul_(2.0).sub_(1.0))


def _timed(env: GpuVecEnv, steps: int, work: Callable[[], Any]) -> float:
    """Return the mean time of a call in a series of calls [s]."""
    with torch.no_grad():
        work()
        _wait(env)
        start = time.perf_counter()
        for _ in range(steps):
            work()
        _wait(env)
    return (time.perf_counter() - start) / steps


def _in_play(env: GpuVecEnv, steps: int) -> tuple[float, float]:
    """Return the time of a step with random actions, and of its physics [s].

    Repeated physics without actions would be too fast, because the arms come to rest.
    """
    simulate, marks = env._simulate, []

    def noted() -> None:
        marks.append(_mark(env))
        simulate()
        marks.append(_mark(env))

    env._simulate = noted
    whole = _timed(env, steps, lambda: _play(env, 1))
    env._simulate = simulate
    spent = [_between(*marks[i : i + 2]) for i in range(2, len(marks), 2)]
    return whole, sum(spent) / steps


def _mark(env: GpuVecEnv) -> Any:
    if not env.device.startswith("cuda"):
        return time.perf_counter()
    event: Any = torch.cuda.Event(enable_timing=True)  # type: ignore[no-untyped-call]
    event.record()
    return event


def _between(begin: Any, end: Any) -> float:
    if isinstance(begin, float):
        return float(end - begin)
    return 1e-3 * float(begin.elapsed_time(end))


def _wait(env: GpuVecEnv) -> None:
    wp.synchronize()
    if env.device.startswith("cuda"):
        torch.cuda.synchronize()
