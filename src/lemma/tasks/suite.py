"""The eight tasks of the paper, and their frozen instances."""

import gzip
import json
from functools import lru_cache
from importlib import import_module
from importlib.resources import files

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.sampling import sample
from lemma.tasks.task import TASKS, Task

SUITE = (
    "pass",
    "pass2",
    "stack",
    "stack2",
    "poke",
    "poke_stack",
    "hook",
    "hook_stack",
)
"""The tasks in the order of the paper's tables."""

FREE_SPLIT = "free"
"""Split of instances that are sampled on demand, numbered by their seed."""

for _name in SUITE:
    # A keyword cannot name a module.
    import_module(f"lemma.tasks.library.{'pass_' if _name == 'pass' else _name}")


def task_named(name: str) -> Task:
    """Return a task.

    Raises:
        UnknownNameError: No task has that name.
    """
    return TASKS[name]


def load_instance(task: str, split: str, index: int) -> Instance:
    """Return a frozen instance, or sample one of the ``"free"`` split.

    Args:
        task: Name of the task.
        split: ``"train"``, ``"val"``, ``"test"`` or ``"free"``.
        index: Number in the split; of a free instance, its seed.

    Raises:
        UnknownNameError: No such task or split.
        InvalidConfigError: The index is out of range.
    """
    record = task_named(task)
    if split == FREE_SPLIT:
        return sample(record, split, index).instance
    if split not in SPLITS:
        raise UnknownNameError("split", split, (*SPLITS, FREE_SPLIT))
    if task not in SUITE:
        raise InvalidConfigError(
            f"Task {task!r} has no frozen instances; only the suite's eight have. Use "
            f"split {FREE_SPLIT!r} with any index as seed."
        )
    count = SPLITS[split]
    if not 0 <= index < count:
        raise InvalidConfigError(
            f"Index {index} is out of range: split {split!r} has {count} instances per "
            f"task, 0 to {count - 1}."
        )
    return Instance.from_dict(json.loads(_frozen_lines(task, split)[index]))


@lru_cache
def _frozen_lines(task: str, split: str) -> tuple[str, ...]:
    source = files("lemma.tasks") / "frozen" / f"{task}-{split}.jsonl.gz"
    return tuple(gzip.decompress(source.read_bytes()).decode().splitlines())
