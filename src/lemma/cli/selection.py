"""Selection of an instance: frozen, by split and index, or sampled by seed."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from lemma.cli.options import File, Number, Team, Word
from lemma.core.arguments import whole
from lemma.core.errors import InvalidConfigError
from lemma.robots.ur.build import ARMS
from lemma.tasks.instance import LARGEST_INDEX, Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, TASKS, default_split, load_instance
from lemma.tasks.teams.layouts import LAYOUTS


@dataclass(frozen=True, slots=True)
class Selection:
    """Selection of an instance of a task."""

    split: Word = None
    """Frozen list of the instance: train, val or test; or free, which samples it. The
    default is test, and free for your own tasks."""
    index: Number = None
    """Index in that list, or seed of split free; 0 by default."""
    seed: Number = None
    """Sample a new instance with this seed instead of a frozen one."""
    robots: Team = None
    """Sample a new instance with these arms from left to right, such as ur5,ur10."""
    instance: File = None
    """JSON file with your own instance, saved by lemma play or with Python's
    Instance.to_json()."""


DEFAULT = Selection()
"""The first frozen test instance."""

SelectionOptions = Annotated[Selection, tyro.conf.arg(name="")]
"""The fields of a selection as options of a verb."""


def select_instance(task: str | None, wish: Selection) -> Instance:
    """Return the selected instance.

    Args:
        task: Name of the task; None if the file names it.
        wish: The selection.

    Raises:
        UnknownNameError: No such task, split or arm type.
        InvalidConfigError: The index is out of range, the file contains no instance, or
            options contradict each other.
    """
    if wish.instance is not None:
        return read_instance(wish.instance, task, wish)
    if task is None:
        raise InvalidConfigError("Name a task, or a file with --instance FILE.json.")
    TASKS[task]
    listed = wish.seed is None and wish.robots is None
    if listed:
        split = wish.split or default_split(task, "test")
        return load_instance(task, split, wish.index or 0)
    if wish.index is not None or wish.split not in (None, FREE_SPLIT):
        raise InvalidConfigError(
            "--split and --index select a frozen instance, --seed and --robots sample "
            "a new one. Use either the first two or the last two."
        )
    seed = whole("seed", wish.seed or 0, 0, LARGEST_INDEX)
    if wish.robots is None:
        return load_instance(task, FREE_SPLIT, seed)
    team = parse_team(wish.robots, LAYOUTS[TASKS[task].layout].size)
    return sample(TASKS[task], FREE_SPLIT, seed, team=team).instance


def read_instance(path: Path, task: str | None, wish: Selection = DEFAULT) -> Instance:
    """Return a user-defined instance.

    Args:
        path: The JSON file.
        task: Required task of the instance; None for any.
        wish: Other options that select an instance, which must have their defaults.

    Raises:
        UnknownNameError: The file names a task, robot or object that does not exist.
        InvalidConfigError: The file contains no instance or one of another task, or
            other options are used besides it.
    """
    found = Instance.load(path)
    TASKS[found.task]
    if task not in (None, found.task):
        raise InvalidConfigError(
            f"{path} is an instance of {found.task}, not of {task}. Name no task."
        )
    others = ("split", "index", "seed", "robots")
    if any(getattr(wish, name) is not None for name in others):
        raise InvalidConfigError(
            "--instance names a file with the whole instance. Use it without --split, "
            "--index, --seed and --robots."
        )
    return found


def parse_team(robots: str, size: int) -> tuple[str, ...]:
    """Return the arm types of a team from text such as ``"ur5,ur10"``.

    Args:
        robots: The text.
        size: Number of robots of the task.

    Raises:
        UnknownNameError: No such arm type.
        InvalidConfigError: The number of arm types is not ``size``.
    """
    names = [name.strip() for name in robots.split(",")]
    for name in names:
        ARMS[name]
    if len(names) != size:
        raise InvalidConfigError(
            f"--robots {robots} names {len(names)} arm type(s), but a team has {size}. "
            f"Separate them by a comma: {','.join(['ur5'] * (size - 1))},ur10. Valid: "
            f"{', '.join(ARMS)}."
        )
    return tuple(names)
