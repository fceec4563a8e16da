"""`lemma tasks`: the suite, and what plugins add to it, as a table."""

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from lemma.cli.options import JsonFlag, output, print_json
from lemma.scene.objects.entity import STICK
from lemma.tasks.suite import TASKS, default_split, load_instance


def tasks(as_json: JsonFlag = False) -> int:
    """List the eight tasks of the suite, and those of plugins.

    Args:
        as_json: Print a JSON list instead of a table.
    """
    records = [describe(name) for name in TASKS]
    if as_json:
        print_json(records)
        return 0
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 1, 0))
    table.add_column("task", style="bold", no_wrap=True)
    for heading in ("sub-\ntasks", "objects", "distractors"):
        table.add_column(heading, justify="right")
    table.add_column("stick")
    table.add_column("what happens, and how it is asked for", ratio=1)
    for record in records:
        low, high = record["objects"]
        few, many = record["distractors"]
        table.add_row(
            Text.assemble(record["task"], "\n", (record["gym_id"], "not bold dim")),
            str(record["subtasks"]),
            f"{low}-{high}",
            f"{few}-{many}",
            "used" if record["stick"] else "–",
            Text.assemble(
                record["summary"], "\n", (record["high_level"], "italic dim")
            ),
        )
    output().print(table)
    return 0


def describe(name: str) -> dict[str, Any]:
    """Return what is known of a task, ready for JSON."""
    task = TASKS[name]
    # How many objects a goal needs is the same in every instance of a task.
    example = load_instance(name, default_split(name, "test"), 0)
    needed = len(example.scene.objects) - len(example.distractors)
    return {
        "task": name,
        "gym_id": task.gym_id,
        "subtasks": task.subtasks,
        "objects": [needed + extra for extra in task.distractors],
        "distractors": list(task.distractors),
        "stick": STICK in example.scene.object_names,
        "summary": task.summary,
        "high_level": task.language.high_level[0].text,
    }
