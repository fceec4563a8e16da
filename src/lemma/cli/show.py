"""`lemma show`: pictures of an instance."""

from pathlib import Path

from lemma.cli.options import File, MaybeTask, messages, output
from lemma.cli.selection import DEFAULT, SelectionOptions, select_instance
from lemma.tasks.rules import problems
from lemma.viz.sheets import check_picture_path, instance_sheet, save_picture


def show(
    task: MaybeTask = None,
    which: SelectionOptions = DEFAULT,
    out: File = None,
) -> int:
    """Draw an instance: cameras, depth, map, reach, goal and instructions, in one PNG.

    Args:
        task: Name of the task, unless the instance is in a file.
        which: Which instance.
        out: The picture (.png, .jpg or .webp); out/show/TASK-SPLIT-INDEX.png by
            default.
    """
    instance = select_instance(task, which)
    name = f"{instance.task}-{instance.split}-{instance.index}.png"
    path = out or Path("out", "show", name)
    check_picture_path(path)
    with messages().status("Drawing ..."):
        picture = instance_sheet(instance)
    save_picture(picture, path)
    console = output()

    def say(name: str, text: str, style: str = "") -> None:
        console.print(f"{name:<11}{text}", style=style, markup=False, soft_wrap=True)

    for kind, sentence in instance.instructions.items():
        say(kind, sentence)
    say("team", instance.team)
    for problem in problems(instance):
        say("problem", problem, "yellow")
    say("goal", _goal(instance.goal.pairs))
    say("picture", str(path), "bold")
    return 0


def _goal(pairs: tuple[tuple[str, str], ...]) -> str:
    return " and ".join(f"{top} on {bottom}" for top, bottom in pairs)
