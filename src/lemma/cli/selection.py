"""Which instance a verb works on: frozen by split and index, or sampled by seed."""

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
    """Which instance of the task."""

    split: Word = None
    """Frozen list to take it from: train, val or test; or free, which samples it. By
    default test, and free for tasks of your own."""
    index: Number = None
    """Number in that list, or the seed; 0 by default."""
    seed: Number = None
    """Sample a new instance with this seed, instead of a frozen one."""
    robots: Team = None
    """Sample a new instance with these arms from left to right, as in ur5,ur10."""
    instance: File = None
    """An instance of your own: a JSON file that lemma play saved, or Python's
    Instance.to_json()."""


DEFAULT = Selection()
"""The first frozen test instance."""

SelectionOptions = Annotated[Selection, tyro.conf.arg(name="")]
"""The fields of a selection as options of a verb."""


def select_instance(task: str | None, wish: Selection) -> Instance:
    """Return the instance that a user asked for.

    Args:
        task: Name of the task; None if the file says it.
        wish: Which one.

    Raises:
        UnknownNameError: No such task, split or arm type.
        InvalidConfigError: The index is out of range, the file holds no instance, or
            the wishes contradict.
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
            "--split and --index name a frozen instance, --seed and --robots sample "
            "a new one. Use either the first two or the last two."
        )
    seed = whole("seed", wish.seed or 0, 0, LARGEST_INDEX)
    if wish.robots is None:
        return load_instance(task, FREE_SPLIT, seed)
    team = parse_team(wish.robots, LAYOUTS[TASKS[task].layout].size)
    return sample(TASKS[task], FREE_SPLIT, seed, team=team).instance


def read_instance(path: Path, task: str | None, wish: Selection = DEFAULT) -> Instance:
    """Return an instance of somebody's own.

    Args:
        path: The JSON file.
        task: Required task of the instance; any if None.
        wish: Other options that select the instance.

    Raises:
        UnknownNameError: It names a task or a thing that does not exist.
        InvalidConfigError: It holds no instance, is of another task, or more was asked
            for than it.
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
            "--instance names a file, which says all of it. Use it without --split, "
            "--index, --seed and --robots."
        )
    return found


def parse_team(robots: str, size: int) -> tuple[str, ...]:
    """Return the arm types of a team that a user typed, such as ``"ur5,ur10"``.

    Args:
        robots: The words.
        size: How many robots the task has.

    Raises:
        UnknownNameError: No such arm type.
        InvalidConfigError: Not as many of them.
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
