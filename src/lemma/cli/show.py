"""`lemma show`: pictures of an instance."""

from pathlib import Path

from lemma.cli.options import File, MaybeTask, messages, print_named
from lemma.cli.selection import DEFAULT, SelectionOptions, select_instance
from lemma.core.errors import InvalidConfigError
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import say_pair
from lemma.tasks.language.relational import has_relational, relational
from lemma.tasks.language.template import RELATIONAL
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
        which: Selection of the instance.
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
    said = (*instance.instructions.items(), *_relational(instance))
    print_named(*said, ("team", instance.team))
    print_named(*(("problem", each) for each in problems(instance)), style="yellow")
    goal = " and ".join(say_pair(top, bottom) for top, bottom in instance.goal.pairs)
    print_named(("goal", goal))
    if (rule := instance.goal.rule) is not None:
        print_named(("rule", " ".join((rule.kind, *rule.names))))
    print_named(("picture", path), style="bold")
    return 0


def _relational(instance: Instance) -> list[tuple[str, str]]:
    """Return the relational instruction with its kind, if there is one."""
    try:
        return [(RELATIONAL, relational(instance))] * has_relational(instance.task)
    except InvalidConfigError:
        # A table of the user's own may have a goal that these sentences cannot say.
        return []
