"""`lemma bench`: the benchmark's own figures, measured here."""

from typing import Annotated, Any

import tyro
from rich.progress import track
from rich.table import Table

from lemma.bench.control import HZ, ControlFigures, measure_control
from lemma.bench.expert_loop import ExpertLoopFigures, measure_expert_loop
from lemma.bench.machine import describe_machine
from lemma.bench.policy import PolicyFigures, measure_policy
from lemma.bench.speed import (
    ExpertFigures,
    Speed,
    expert_figures,
    measure_speed,
    rounded,
    run_trials,
)
from lemma.cli.options import (
    Flag,
    JsonFlag,
    Number,
    TaskNames,
    messages,
    output,
    print_json,
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
    "lowest_ratio": ("in the task in which it is lowest", "{:.2f}", ""),
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
    "look_ms": ("both cameras and the map before each", "{:.0f} ms", ""),
    "decision_ms": ("one decision, median", "{:.0f} ms", "< 150 ms"),
    "slowest_ms": ("one decision, 95 of 100 are faster", "{:.0f} ms", ""),
    "success_rate": ("success in these episodes", "{:.0%}", ""),
    "peak_mb": ("memory of a process that plays", "{:.0f} MB", "< 1500 MB"),
}


def bench(
    tasks: TaskNames = (),
    expert: Flag = False,
    episodes: int = SPLITS[_SPLIT],
    workers: Number = None,
    policy: Annotated[
        str | None, tyro.conf.arg(metavar="POLICY", help_behavior_hint="")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Measure speed, memory and, if asked to, the expert's success.

    Args:
        tasks: Tasks to measure with; all eight if none is named.
        expert: Measure the expert's success as well, which takes minutes.
        episodes: Frozen instances per task, and as many fresh ones, for the expert.
        workers: Processes for the expert; one per core by default.
        policy: Measure instead how fast this policy decides, and how much memory it
            needs.
        as_json: Print one JSON object on the output, and the progress elsewhere.
    """
    names = tuple(TASKS[name].name for name in dict.fromkeys(tasks)) or SUITE
    if not 1 <= episodes <= SPLITS[_SPLIT] or (workers is not None and workers < 1):
        raise InvalidConfigError(
            f"--episodes goes from 1 to {SPLITS[_SPLIT]}, the length of the frozen "
            f"list, and --workers from 1 up; not {episodes} and {workers}."
        )
    each = min(episodes, _SPEED_EPISODES)
    instances = [load_instance(name, _SPLIT, i) for name in names for i in range(each)]
    machine = describe_machine()
    if policy is not None:
        if expert:
            raise InvalidConfigError(
                "--policy and --expert measure different things. Name one of them."
            )
        _bench_policy(machine, policy, instances, as_json)
        return 0
    with messages().status(f"Measuring speed on {len(instances)} episodes ..."):
        speed = measure_speed(instances)
        loop = measure_expert_loop(instances[::each])
        control = measure_control(instances[0])
    figures: dict[str, ExpertFigures] = {}
    if expert:
        trials = track(
            run_trials(names, episodes, workers or usable_cores()),
            "The expert at work",
            total=2 * episodes * len(names),
            console=messages(),
        )
        figures = expert_figures(trials)
    if as_json:
        print_json(report(machine, speed, loop, control, figures))
    else:
        _print_machine(machine)
        _print_speed(f"first {each} of split {_SPLIT!r} per task", speed, loop, control)
        if figures:
            _print_expert(figures)
    return 0


def _bench_policy(
    machine: dict[str, Any], policy: str, instances: list[Instance], as_json: bool
) -> None:
    with messages().status(f"Playing {len(instances)} episodes ..."):
        found = measure_policy(policy, instances)
    if as_json:
        print_json({"machine": machine, "policy": found.to_dict()})
    else:
        _print_policy(machine, found, policy)


def report(
    machine: dict[str, Any],
    speed: Speed,
    loop: ExpertLoopFigures,
    control: ControlFigures,
    figures: dict[str, ExpertFigures],
) -> dict[str, Any]:
    """Return the one object that ``--json`` prints."""
    return {
        "machine": machine,
        "speed": rounded(speed),
        "loop": rounded(loop),
        "control": rounded(control),
        "expert": {task: rounded(found) for task, found in figures.items()},
    }


def _print_speed(
    instances: str, speed: Speed, loop: ExpertLoopFigures, control: ControlFigures
) -> None:
    output().print(_figures(f"Speed ({instances})", speed, _TARGETS))
    title = "The expert's loop beside bare physics, one instance per task"
    output().print(_figures(title, loop, _LOOP_TARGETS))
    title = f"Control level, {HZ:g} steps per simulated second, random actions"
    output().print(_figures(title, control, _CONTROL_TARGETS))


def _print_expert(figures: dict[str, ExpertFigures]) -> None:
    table = Table(title="The expert", title_justify="left")
    table.add_column("task", style="bold")
    for heading in (
        *("episodes", "solved", "solved, fresh"),
        *("mean sim s", "longest", "rejected"),
    ):
        table.add_column(heading, justify="right")
    for task, found in figures.items():
        table.add_row(
            task,
            str(found.episodes),
            f"{found.success_rate:.1%}",
            f"{found.raw_success_rate:.1%}",
            f"{found.mean_sim_s:.1f}",
            f"{found.max_sim_s:.1f}",
            f"{found.rejection_rate:.1%}",
        )
    output().print(table)


def _print_policy(machine: dict[str, Any], found: PolicyFigures, policy: str) -> None:
    _print_machine(machine)
    output().print(_figures(f"Policy {policy}", found, _POLICY_TARGETS))


def _print_machine(machine: dict[str, Any]) -> None:
    output().print(", ".join(f"{key} {value}" for key, value in machine.items()))


def _figures(
    title: str, found: object, targets: dict[str, tuple[str, str, str]]
) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("figure")
    table.add_column("measured", justify="right", style="bold")
    table.add_column("target", justify="right")
    for name, (words, form, target) in targets.items():
        table.add_row(words, form.format(getattr(found, name)), target)
    return table
