"""Names of tasks: the suite's, their order, and what Gymnasium calls them.

Imports nothing, so that ``import lemma`` can register the suite at once.
"""

from collections.abc import Iterable

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
"""The benchmark's eight tasks, in the order of the paper's tables."""


def gym_id(task: str) -> str:
    """Return Gymnasium's name of a task: ``"lemma/PokeStack-v0"``."""
    return f"lemma/{''.join(word.capitalize() for word in task.split('_'))}-v0"


def task_rank(task: str) -> tuple[int, str]:
    """Return what tasks are sorted by: the suite's in its order, then the alphabet.

    It does not depend on what is registered, so that results can be read without the
    plugin that their tasks are from.
    """
    return (SUITE.index(task), "") if task in SUITE else (len(SUITE), task)


def in_order(tasks: Iterable[str]) -> tuple[str, ...]:
    """Return names of tasks, each once, the suite's first."""
    return tuple(sorted(set(tasks), key=task_rank))
