"""`lemma schedule`: the schedule of least makespan as a Gantt chart in text."""

from pathlib import Path

from lemma.cli.options import (
    Folder,
    JsonFlag,
    MaybeTask,
    messages,
    output,
    print_json,
    print_named,
)
from lemma.cli.selection import DEFAULT, SelectionOptions, select_instance
from lemma.core.files import write_text
from lemma.env.simulation import Simulation
from lemma.evaluation.protocol.schedules import executed_s, schedule_of
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.pddl import to_pddl
from lemma.planning.schedule import Schedule
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.instance import Instance

_WIDTH = 64
"""Width of the chart [characters]."""
_SIGNS = "0123456789abcdefghijklmnopqrstuvwxyz"


def schedule(
    task: MaybeTask = None,
    which: SelectionOptions = DEFAULT,
    export: Folder = None,
    as_json: JsonFlag = False,
) -> int:
    """Print the schedule of least makespan of an instance.

    Args:
        task: Name of the task, unless the instance is in a file.
        which: Selection of the instance.
        export: Instead of scheduling, write the instance as a temporal planning problem
            to this folder: domain.pddl, problem.pddl and instance.json.
        as_json: Print one JSON object instead of a chart.
    """
    instance = select_instance(task, which)
    if export is not None:
        for file in write_export(instance, export):
            output().print(str(file), soft_wrap=True)
        return 0
    with messages().status("Scheduling ..."):
        found = schedule_of(instance)
    oracle_s, path = executed_s(instance), found.critical_path()
    if as_json:
        print_json(
            {"instance": instance.key, **found.to_dict(), "executed_s": oracle_s}
        )
        return 0
    print_named(
        ("instance", f"{instance.key}: {instance.instructions['high_level']}"),
        ("one by one", f"{found.sequential_s:.2f} s, predicted"),
        ("makespan", f"{found.makespan_s:.2f} s, predicted, {found.status}"),
        ("executed", f"{oracle_s:.2f} s" if oracle_s else "not in the table"),
        ("critical", " ".join(_SIGNS[k] for k in path)),
    )
    for line in gantt(found, instance.scene.robot_names):
        output().print(line, soft_wrap=True)
    for k, (job, robot) in enumerate(zip(found.jobs, found.robots, strict=True)):
        begin, _, effect, end = (found.at(k, stage) / 100 for stage in range(4))
        times = f"{begin:5.2f} to {effect:5.2f}, home {end:5.2f}"
        sub = job.subtask
        said = f"{robot}: {sub.primitive} {sub.pick} to {sub.place}"
        output().print(f"{_SIGNS[k]}  {times}  {said}", soft_wrap=True)
    return 0


def write_export(instance: Instance, folder: Path) -> tuple[Path, ...]:
    """Write an instance in PDDL for external planners; return the files.

    Raises:
        InvalidConfigError: PDDL cannot express it.
    """
    name = instance.key.replace("/", "-")
    scene, grounder = (
        Simulation(instance.scene).scene,
        GeometricGrounder(instance.scene),
    )
    pddl = to_pddl(name, SymbolicState.observe(scene), instance.goal, grounder)
    texts = {
        "domain.pddl": pddl.domain,
        "problem.pddl": pddl.problem,
        "instance.json": instance.to_json(),
    }
    for file, text in texts.items():
        write_text(folder / file, text)
    return tuple(folder / file for file in texts)


def gantt(found: Schedule, robots: tuple[str, ...]) -> list[str]:
    """Return a line of text for each robot, and one with the time below.

    A sub-task is drawn as its sign until its effect, then as dashes until its robot is
    home. Dots mean a free robot.

    Args:
        found: The schedule.
        robots: Names of the team.
    """
    scale = _WIDTH / max(found.makespan_s * 100, 1)
    rows = {robot: ["."] * _WIDTH for robot in robots}
    for k, robot in enumerate(found.robots):
        begin, effect, end = (round(found.at(k, s) * scale) for s in (0, 2, 3))
        rows[robot][begin:end] = _SIGNS[k] * (effect - begin) + "-" * (end - effect)
    lines = [f"{robot:<9}{''.join(row)}" for robot, row in rows.items()]
    return [*lines, f"{'':9}0{found.makespan_s:>{_WIDTH - 3}.1f} s"]
