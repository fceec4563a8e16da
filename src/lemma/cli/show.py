"""`lemma show`: pictures of an instance."""

from pathlib import Path
from typing import Annotated

import tyro

from lemma.cli.selection import select_instance
from lemma.cli.sheet import instance_sheet
from lemma.cli.terminal import messages, output
from lemma.tasks.template import KINDS


def show(
    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")],
    split: str | None = None,
    index: int | None = None,
    seed: int | None = None,
    robots: str | None = None,
    out: Path | None = None,
) -> int:
    """Draw an instance: cameras, depth, map, reach, goal and instructions, in one PNG.

    Args:
        task: Name of the task.
        split: Frozen list to take the instance from: train, val or test (default).
        index: Number of the instance in its split; 0 by default.
        seed: Sample a new instance with this seed, instead of a frozen one.
        robots: Sample a new instance with these arm types, such as ur5,ur10.
        out: The PNG file; out/show/TASK-SPLIT-INDEX.png by default.
    """
    instance = select_instance(
        task, split=split, index=index, seed=seed, robots=robots
    )
    name = f"{instance.task}-{instance.split}-{instance.index}.png"
    path = out or Path("out", "show", name)
    with messages().status("Drawing ..."):
        picture = instance_sheet(instance)
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(path)
    console = output()
    for kind in KINDS:
        console.print(f"{kind:<11}{instance.instructions[kind]}", soft_wrap=True)
    console.print(f"{'team':<11}{instance.team}")
    console.print(f"{'goal':<11}{_goal(instance.goal.pairs)}", soft_wrap=True)
    console.print(f"{'picture':<11}{path}", style="bold", soft_wrap=True)
    return 0


def _goal(pairs: tuple[tuple[str, str], ...]) -> str:
    return " and ".join(f"{top} on {bottom}" for top, bottom in pairs)
