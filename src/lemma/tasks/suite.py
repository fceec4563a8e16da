"""Frozen and sampled instances of tasks."""

import gzip
import json
from functools import lru_cache
from importlib.resources import files

from lemma.core.arguments import known, whole
from lemma.core.errors import InvalidConfigError
from lemma.tasks import library  # noqa: F401 - adds tasks
from lemma.tasks.instance import LARGEST_INDEX, SPLITS, Instance, splits_of
from lemma.tasks.names import LADDER, LISTED, SUITE, SUITES
from lemma.tasks.sampling import sample
from lemma.tasks.task import TASKS
from lemma.tasks.teams import (  # noqa: F401 - adds tasks
    bridge,
    carry,
    families,
    give,
    strong,
    unison,
)
from lemma.tasks.teams.pairs import PAIR_TASK, PAIRS, instance_of_pair

__all__ = [
    "FREE_SPLIT",
    "LADDER",
    "LISTED",
    "SUITE",
    "SUITES",
    "TASKS",
    "check_split",
    "default_split",
    "has_frozen_lists",
    "load_instance",
]

FREE_SPLIT = "free"
"""Split of instances that are sampled on demand; their index is the seed."""


def has_frozen_lists(task: str) -> bool:
    """Return whether a task has frozen lists of instances, as tasks of suites do."""
    return task in LISTED


def default_split(task: str, split: str = "train") -> str:
    """Return the default split of a task.

    Args:
        task: Name of the task.
        split: The split of tasks with frozen lists; that of others is ``"free"``.
    """
    return split if has_frozen_lists(task) else FREE_SPLIT


def check_split(task: str, split: str) -> None:
    """Check that a task has a split.

    Raises:
        UnknownNameError: No such task or split.
        InvalidConfigError: The task has no frozen lists.
    """
    TASKS[task]
    pairs = (PAIRS,) if task == PAIR_TASK else ()
    known("split", split, (*SPLITS, FREE_SPLIT, *pairs))
    if split != FREE_SPLIT and not has_frozen_lists(task):
        raise InvalidConfigError(
            f"Task {task!r} has no frozen list {split!r}; only those of suites "
            f"have lists. Use split {FREE_SPLIT!r}, whose index is the seed."
        )


def load_instance(task: str, split: str, index: int) -> Instance:
    """Return a frozen instance, or sample one of the ``"free"`` split.

    Args:
        task: Name of the task.
        split: ``"train"``, ``"val"``, ``"test"`` or ``"free"``; of ``pass`` also
            ``"pairs"``, see :mod:`lemma.tasks.teams.pairs`.
        index: Index in the split; the seed for ``"free"``.

    Raises:
        UnknownNameError: No such task or split.
        InvalidConfigError: The index is out of range, or the task has no such list.
    """
    check_split(task, split)
    if split == FREE_SPLIT:
        seed = whole("index", index, 0, LARGEST_INDEX)
        return sample(TASKS[task], split, seed).instance
    if split == PAIRS:
        return instance_of_pair(index)
    number = whole("index", index, 0, splits_of(task)[split] - 1)
    return Instance.from_dict(json.loads(_frozen_lines(task, split)[number]))


@lru_cache
def _frozen_lines(task: str, split: str) -> tuple[str, ...]:
    source = files("lemma.tasks") / "frozen" / f"{task}-{split}.jsonl.gz"
    return tuple(gzip.decompress(source.read_bytes()).decode().splitlines())
