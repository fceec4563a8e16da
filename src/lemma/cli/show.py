"""`lemma show`: pictures of an instance."""

from pathlib import Path

from lemma.cli.options import File, MaybeTask, messages, output
from lemma.cli.selection import DEFAULT, SelectionOptions, select_instance
from lemma.tasks.language.template import KINDS
from lemma.tasks.rules import problems
from lemma.viz.instance_sheet import instance_sheet


def show(
    task: MaybeTask = None,
    which: SelectionOptions = DEFAULT,
    out: File = None,
) -> int:
    """Draw an instance: cameras, depth, map, reach, goal and instructions, in one PNG.

    Args:
        task: Name of the task, unless the instance is in a file.
        which: Which instance.
        out: The PNG file; out/show/TASK-SPLIT-INDEX.png by default.
    """
    instance = select_instance(task, which)
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
    for problem in problems(instance):
        console.print(f"{'problem':<11}{problem}", style="yellow", soft_wrap=True)
    console.print(f"{'goal':<11}{_goal(instance.goal.pairs)}", soft_wrap=True)
    console.print(f"{'picture':<11}{path}", style="bold", soft_wrap=True)
    return 0


def _goal(pairs: tuple[tuple[str, str], ...]) -> str:
    return " and ".join(f"{top} on {bottom}" for top, bottom in pairs)
