"""`lemma tasks`: a table of the tasks of a suite and of plugins."""

from typing import Any

from lemma.cli.options import JsonFlag, SuiteName, print_json, print_table
from lemma.scene.objects.entity import STICK
from lemma.tasks.suite import LISTED, SUITES, TASKS, default_split, load_instance

_HEADER = (
    *("task", "summary and instruction"),
    *("sub-\ntasks", "objects", "distractors", "stick"),
)


def tasks(suite: SuiteName = "lemma", as_json: JsonFlag = False) -> int:
    """List the tasks of a suite, and those of plugins.

    Args:
        suite: lemma: the eight tasks of the paper; ladder: easier tasks; teams: tasks
            for two to four robots.
        as_json: Print a JSON list instead of a table.
    """
    own = (name for name in TASKS if name not in LISTED)
    names = (*SUITES[suite], *own)
    records = [describe(name) for name in names]
    if as_json:
        print_json(records)
        return 0
    rows = [
        (
            f"{one['task']}\n{one['gym_id']}",
            f"{one['summary']}\n“{one['high_level']}”\n",
            one["subtasks"],
            *("{}-{}".format(*one[name]) for name in ("objects", "distractors")),
            "used" if one["stick"] else "–",
        )
        for one in records
    ]
    print_table(_HEADER, rows, labels=2)
    return 0


def describe(name: str) -> dict[str, Any]:
    """Return the properties of a task, ready for JSON."""
    task = TASKS[name]
    # All instances of a task need the same number of objects.
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
