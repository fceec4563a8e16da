"""`lemma bench`: the benchmark's speed and memory, measured on this machine."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.progress import track

from lemma.bench.episodes import (
    PARALLEL_TASKS,
    expert_figures,
    measure_policy,
    measure_together,
    run_trials,
)
from lemma.bench.machine import describe_machine
from lemma.bench.speed import (
    HZ,
    Figures,
    measure_control,
    measure_expert_loop,
    measure_speed,
)
from lemma.cli.options import (
    Flag,
    Folder,
    JsonFlag,
    Number,
    TaskNames,
    messages,
    output,
    print_figures,
    print_json,
    print_table,
)
from lemma.core.errors import InvalidConfigError
from lemma.core.workers.resources import usable_cores
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, TASKS, load_instance

_SPLIT = "test"
_SPEED_EPISODES = 3
_TARGETS = {
    "realtime_factor": ("simulated seconds per second, one core", "{:.0f}", "≥ 60"),
    "camera_fps": ("camera pictures per second, RGB and depth", "{:.0f}", "≥ 50"),
    "map_ms": ("top-down map of two cameras", "{:.1f} ms", "< 5 ms"),
    "sample_ms": ("sampling an instance, mean", "{:.0f} ms", "< 1000 ms"),
    "reset_state_ms": ("reset to the first state", "{:.1f} ms", "< 20 ms"),
    "reset_images_ms": ("reset to the first pictures", "{:.1f} ms", "< 80 ms"),
    "peak_mb": ("memory of one environment, with cameras", "{:.0f} MB", "< 400 MB"),
}
"""Meaning, format and target of every figure."""
_LOOP_TARGETS = {
    "expert_realtime": ("simulated seconds per second, the expert", "{:.0f}", ""),
    "bare_realtime": ("mj_step with the same motor commands", "{:.0f}", ""),
    "ratio": ("the expert over bare physics", "{:.2f}", "≥ 0.7"),
    "lowest_ratio": ("the same, lowest of all tasks", "{:.2f}", ""),
}
_CONTROL_TARGETS = {
    "bare_physics_hz": ("bare physics, ten mj_step", "{:.0f} steps/s", ""),
    "joint_position_hz": ("joint_position", "{:.0f} steps/s", ""),
    "joint_position_ratio": ("over bare physics", "{:.2f}", "≥ 0.6"),
    "ee_pose_hz": ("ee_pose", "{:.0f} steps/s", ""),
    "ee_pose_ratio": ("over bare physics", "{:.2f}", "≥ 0.5"),
    "rgbd_hz": ("with two 320 x 240 RGB-D cameras", "{:.0f} steps/s", "≥ 80"),
}
_POLICY_TARGETS = {
    "decisions": ("decisions that were timed", "{:.0f}", ""),
    "look_ms": ("both cameras and the map per decision", "{:.0f} ms", ""),
    "decision_ms": ("one decision, median", "{:.0f} ms", "< 150 ms"),
    "slowest_ms": ("one decision, 95th percentile", "{:.0f} ms", ""),
    "success_rate": ("success in these episodes", "{:.0%}", ""),
    "peak_mb": ("peak memory of an evaluating process", "{:.0f} MB", "< 1500 MB"),
}
_TRAINING_TARGETS = {
    "samples_per_s": ("frames, or episodes, per second", "{:.0f}", ""),
    "frames_per_s": ("frames per second", "{:.0f}", ""),
    "gpu_busy": ("share of the time in which the GPU works", "{:.0%}", "≥ 80 %"),
    "gpu_memory_gb": ("memory of the GPU", "{:.1f} GB", ""),
    "start_s": ("time until training is at full speed", "{:.0f} s", ""),
    "eager_samples_per_s": ("without capture and compiler", "{:.0f}", ""),
    "eager_gpu_busy": ("share of the time in which the GPU works", "{:.0%}", ""),
}
_TOGETHER_TARGETS = {
    "success_rate": ("success, all robots at once", "{:.0%}", "100%"),
    "sequential_s": ("one robot at a time, mean", "{:.1f} s", ""),
    "makespan_s": ("all robots at once, mean makespan", "{:.1f} s", ""),
    "makespan_ratio": ("makespan over one at a time", "{:.2f}", ""),
    "waited_s": ("waiting for reserved sectors, all robots", "{:.1f} s", ""),
    "retreats": ("deadlocks resolved by a retreat", "{:.0f}", ""),
    "deadlocks": ("sub-tasks that ended as deadlock", "{:.0f}", "0"),
    "clearance_mm": ("least distance between arms", "{:.0f} mm", "≥ 50 mm"),
    "loop_ratio": ("the loop over bare physics", "{:.2f}", "≥ 0.7"),
}
_GPU_TARGETS = {
    "graph_hz": ("control steps per second, all tables", "{:,.0f}", "≥ 150,000"),
    "eager_hz": ("without CUDA graphs beside physics", "{:,.0f}", ""),
    "physics_hz": ("physics of these steps alone", "{:,.0f}", ""),
    "outside": ("share of time outside physics", "{:.0%}", "≤ 30 %"),
    "eager_outside": ("without CUDA graphs beside physics", "{:.0%}", ""),
    "images_hz": ("RGB-D pictures per second, 128 x 128", "{:,.0f}", "≥ 60,000"),
    "rgbd_hz": ("control steps per second with two of them", "{:,.0f}", ""),
    "lost_worlds": ("worlds with a state that is NaN", "{:.0f}", "0"),
    "ready_s": ("time until the first step, with compilation", "{:.0f} s", ""),
}
_WORLDS = 4096
_Images = Literal["auto", "device", "host"]
_GROUPS = {
    "speed": (f"Speed (first {{each}} of split {_SPLIT!r} per task)", _TARGETS),
    "loop": (
        "The expert's loop beside bare physics, one instance per task",
        _LOOP_TARGETS,
    ),
    "control": (
        f"Control level, {HZ:g} steps per simulated second, random actions",
        _CONTROL_TARGETS,
    ),
    "policy": ("Policy {policy}", _POLICY_TARGETS),
    "training": ("Training of {training}", _TRAINING_TARGETS),
}
_EXPERT_FORMS = {
    "episodes": ("episodes", "{:.0f}"),
    "success_rate": ("solved", "{:.1%}"),
    "raw_success_rate": ("solved, fresh", "{:.1%}"),
    "mean_sim_s": ("mean sim s", "{:.1f}"),
    "max_sim_s": ("longest", "{:.1f}"),
    "rejection_rate": ("rejected", "{:.1%}"),
}


def bench(
    tasks: TaskNames = (),
    expert: Flag = False,
    episodes: int = SPLITS[_SPLIT],
    workers: Number = None,
    together: Flag = False,
    policy: Annotated[
        str | None, tyro.conf.arg(metavar="POLICY", help_behavior_hint="")
    ] = None,
    training: Annotated[
        str | None, tyro.conf.arg(metavar="MODEL", help_behavior_hint="")
    ] = None,
    data: Folder = None,
    images: _Images = "auto",
    gpu: Flag = False,
    worlds: Number = None,
    as_json: JsonFlag = False,
) -> int:
    """Measure speed, memory and, with --expert, the expert's success.

    Args:
        tasks: Tasks to measure with; all eight if none is named.
        expert: Measure the expert's success as well, which takes minutes.
        episodes: Frozen instances per task, and as many fresh ones, for the expert.
        workers: Processes for the expert; one per core by default.
        together: Instead, measure the expert with all robots acting at the same time,
            in these tasks or in pass2 and stack2.
        policy: Instead, measure the decision time and memory of this policy.
        training: Instead, measure the training speed of this model and the GPU's load.
        data: With --training: folder of keyframes that lemma render wrote.
        images: With --training: memory for the images, as in lemma train.
        gpu: Instead, measure many worlds at once with lemma.make_gpu_vec, in these
            tasks or in stack.
        worlds: With --gpu: number of worlds; 4096 by default.
        as_json: Print one JSON object on the standard output, and progress on the
            error stream.
    """
    names = tuple(TASKS[name].name for name in dict.fromkeys(tasks)) or SUITE
    asked = {"--policy": policy, "--training": training, "--expert": expert,
             "--together": together, "--gpu": gpu}  # fmt: skip
    _check_options(asked, episodes, workers, data, worlds, images)
    if gpu:
        return _bench_gpu(names if tasks else ("stack",), worlds or _WORLDS, as_json)
    if together:
        return _bench_together(names if tasks else PARALLEL_TASKS, episodes, as_json)
    each = min(episodes, _SPEED_EPISODES)
    machine = describe_machine()
    found = _measure(names, each, policy, training, data, images)
    experts = _measure_expert(names, episodes, workers) if expert else {}
    if as_json:
        report: dict[str, object] = {n: _rounded(of) for n, of in found.items()}
        if policy is None and training is None:
            report["expert"] = {task: _rounded(of) for task, of in experts.items()}
        print_json({"machine": machine, **report})
        return 0
    _print_machine(machine)
    for name, figures in found.items():
        _print_group(name, figures, policy=policy, training=training, each=each)
    _print_experts(experts)
    return 0


def _measure(
    names: tuple[str, ...],
    each: int,
    policy: str | None,
    training: str | None,
    data: Path | None,
    images: _Images,
) -> dict[str, Figures]:
    instances = [load_instance(name, _SPLIT, i) for name in names for i in range(each)]
    if training is not None and data is not None:
        return {"training": _measure_training(training, data, images)}
    if policy is not None:
        with messages().status(f"Playing {len(instances)} episodes ..."):
            return {"policy": measure_policy(policy, instances)}
    return _measure_speed(instances, each)


def _print_machine(machine: Mapping[str, object]) -> None:
    output().print(", ".join(f"{key} {value}" for key, value in machine.items()))


def _print_group(name: str, figures: Figures, **fields: object) -> None:
    title, targets = _GROUPS[name]
    # Training on a CPU has fewer figures.
    measured = {n: form for n, form in targets.items() if n in figures}
    print_figures(figures, measured, title.format(**fields))


def _check_options(
    asked: Mapping[str, object],
    episodes: int,
    workers: int | None,
    data: Path | None,
    worlds: int | None,
    images: _Images,
) -> None:
    if not 1 <= episodes <= SPLITS[_SPLIT] or (workers is not None and workers < 1):
        raise InvalidConfigError(
            f"--episodes goes from 1 to {SPLITS[_SPLIT]}, the length of the frozen "
            f"list, and --workers from 1 up; not {episodes} and {workers}."
        )
    if len([name for name, value in asked.items() if value]) > 1:
        raise InvalidConfigError(
            "--policy, --training, --expert, --together and --gpu measure different "
            "things. Name one of them."
        )
    if (asked["--training"] is None) != (data is None):
        raise InvalidConfigError(
            "--training MODEL needs --data DIR, and --data needs --training."
        )
    if images != "auto" and asked["--training"] is None:
        raise InvalidConfigError("--images needs --training.")
    if worlds is not None and not (asked["--gpu"] and worlds >= 1):
        raise InvalidConfigError(
            f"--worlds needs --gpu and is at least 1, not {worlds}."
        )


def _measure_speed(instances: Sequence[Instance], each: int) -> dict[str, Figures]:
    with messages().status(f"Measuring speed on {len(instances)} episodes ..."):
        return {
            "speed": measure_speed(instances),
            "loop": measure_expert_loop(instances[::each]),
            "control": measure_control(instances[0]),
        }


def _measure_training(model: str, data: Path, images: _Images) -> Figures:
    # Import late: torch is optional.
    from lemma.policies.training.config import TrainingConfig
    from lemma.policies.training.speed import measure_training

    config = TrainingConfig(model, data, data / "unused", images=images)
    with messages().status(f"Training {model} for some steps ..."):
        found = measure_training(config)
    if math.isnan(found["gpu_busy"]):
        return {name: found[name] for name in ("samples_per_s", "frames_per_s")}
    return found


def _bench_together(names: tuple[str, ...], episodes: int, as_json: bool) -> int:
    found = {}
    for name in track(names, "All robots at once", console=messages()):
        instances = [load_instance(name, _SPLIT, i) for i in range(episodes)]
        found[name] = measure_together(instances)
    if as_json:
        rounded = {name: _rounded(figures) for name, figures in found.items()}
        print_json({"machine": describe_machine(), "together": rounded})
        return 0
    for name, figures in found.items():
        title = f"{name}, first {episodes} of split {_SPLIT!r}"
        forms = {n: form for n, form in _TOGETHER_TARGETS.items() if n in figures}
        print_figures(figures, forms, title)
    return 0


def _bench_gpu(names: tuple[str, ...], worlds: int, as_json: bool) -> int:
    try:
        from lemma.bench.worlds import describe_device, measure_pictures, measure_worlds
    except ImportError as error:
        raise InvalidConfigError(
            f"--gpu needs {error.name}: pip install 'lemma-bench[warp]'."
        ) from error

    machine = {**describe_machine(), **describe_device()}
    found = {}
    for name in names:
        with messages().status(f"{name}: {worlds} tables; the first time it compiles"):
            found[name] = measure_worlds(name, worlds)
            found[name] |= measure_pictures(name, worlds)
    if as_json:
        print_json({"machine": machine, "gpu": found})
        return 0
    _print_machine(machine)
    for name, figures in found.items():
        print_figures(figures, _GPU_TARGETS, f"{name}, {worlds} tables, 20 Hz")
        worst = max(figures["differences"].values())
        output().print(f"Largest difference between both paths: {worst:.2g}")
    return 0


def _measure_expert(
    names: tuple[str, ...], episodes: int, workers: int | None
) -> dict[str, Figures]:
    trials = track(
        run_trials(names, episodes, workers or usable_cores()),
        "The expert at work",
        total=2 * episodes * len(names),
        console=messages(),
    )
    return expert_figures(trials)


def _rounded(figures: Figures) -> Figures:
    return {name: round(value, 3) for name, value in figures.items()}


def _print_experts(experts: dict[str, Figures]) -> None:
    if not experts:
        return
    header = ("task", *(heading for heading, _ in _EXPERT_FORMS.values()))
    rows = (
        (task, *(form.format(of[n]) for n, (_, form) in _EXPERT_FORMS.items()))
        for task, of in experts.items()
    )
    print_table(header, rows, "The expert")
