"""`lemma demo`: the expert at work, one instance per task."""

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from lemma.cli.recording import RecordedStep, Recording, record, warm_up
from lemma.cli.selection import select_instance
from lemma.cli.terminal import Flag, JsonFlag, messages, output, print_json
from lemma.tasks.suite import SUITE

_OUT = Path("out/demo")


def demo(
    tasks: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[TASK ...]")
    ] = (),
    split: str | None = None,
    index: int | None = None,
    seed: int | None = None,
    robots: str | None = None,
    out: Path = _OUT,
    no_video: Flag = False,
    as_json: JsonFlag = False,
) -> int:
    """Let the expert solve one instance of each task; write videos and a page.

    Ends with exit code 1 if the expert failed at any task.

    Args:
        tasks: Tasks to solve; all eight if none is named.
        split: Frozen list to take the instance from: train, val or test (default).
        index: Number of the instance in its split; 0 by default.
        seed: Sample a new instance with this seed, instead of a frozen one.
        robots: Sample a new instance with these arm types, such as ur5,ur10.
        out: Folder for the videos and for index.html.
        no_video: Solve only; write nothing.
        as_json: Print one JSON document on the output; progress goes to the error
            stream.
    """
    names = tuple(dict.fromkeys(tasks)) or SUITE
    instances = [
        select_instance(name, split=split, index=index, seed=seed, robots=robots)
        for name in names
    ]
    console = messages() if as_json else output()
    with console.status("Preparing (the first run compiles, for half a minute) ..."):
        warm_up(instances[0])
    recordings = []
    for instance in instances:
        _announce(console, instance.task, instance.instructions["high_level"])
        recordings.append(record(instance, on_step=lambda s: _report(console, s)))
    console.print()
    console.print(summary(recordings))
    if as_json:
        print_json([recording.to_dict() for recording in recordings])
    return 0 if all(recording.success for recording in recordings) else 1


def _announce(console: Console, task: str, instruction: str) -> None:
    line = Text.assemble((f"\n{task}", "bold"), "  ", (f"“{instruction}”", "italic"))
    console.print(line)


def _report(console: Console, step: RecordedStep) -> None:
    subtask = step.subtask
    what = f"{subtask.pick} → {subtask.place}"
    line = Text("  ")
    line.append(f"{step.robot:<16}", style="cyan")
    line.append(f"{subtask.primitive:<8}{what:<26}")
    line.append(f"{step.outcome:<10}", style="green" if step.ok else "bold red")
    line.append(f"{step.duration_s:6.1f} s")
    if not step.ok:
        line.append(f"  {step.explanation}", style="red")
    console.print(line, soft_wrap=True)


def summary(recordings: list[Recording]) -> Table:
    """Return the table at the end: how every task went."""
    table = Table()
    table.add_column("task", style="bold", no_wrap=True)
    table.add_column("instruction", ratio=1)
    table.add_column("team", no_wrap=True)
    for heading in ("sub-tasks", "simulated", "real", "speed"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("success", no_wrap=True)
    for done in recordings:
        answer = "yes" if done.success else f"no: {done.failure}"
        table.add_row(
            done.instance.task,
            done.instance.instructions["high_level"],
            done.instance.team,
            str(len(done.steps)),
            f"{done.elapsed_s:.1f} s",
            f"{done.wall_s:.2f} s",
            f"{done.realtime_factor:.0f}×",
            Text(answer, style="green" if done.success else "bold red"),
        )
    return table
