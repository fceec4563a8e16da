"""Names of the suites' tasks, their order, and their Gymnasium ids.

This module imports nothing else, so that ``import lemma`` can register the suites
quickly.
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


RUNGS = ("reach", "lift", "place", "hand_over", "pass", "stack", "poke", "hook")
"""The rungs of the ladder, from easy to hard; the last four are the paper's."""
DEGREES = ("fixed", "varied", "full")
"""Degrees of variation: objects alone; also robots; also distractors."""


def rung_task(rung: str, degree: str) -> str:
    """Return the task of a rung at a degree, such as ``"lift_fixed"``."""
    return rung if degree == DEGREES[-1] else f"{rung}_{degree}"


LADDER = tuple(rung_task(rung, degree) for rung in RUNGS for degree in DEGREES)
"""The 24 tasks of the suite ``ladder``; four of them are also in suite ``lemma``."""
FAMILIES = (
    "relay",
    "line",
    "carousel",
    "sort",
    "tower",
    "exchange",
    "strong",
    "bridge",
    "carry",
    "give",
    "unison",
)
"""The families of the suite ``teams``, for two to four robots."""
SUITES = {"lemma": SUITE, "ladder": LADDER, "teams": FAMILIES}
"""The tasks of each suite, by name of the suite."""
LISTED = tuple(dict.fromkeys(task for suite in SUITES.values() for task in suite))
"""All tasks with frozen lists, in the order of tables."""


def gym_id(task: str) -> str:
    """Return the Gymnasium id of a task, such as ``"lemma/PokeStack-v0"``."""
    return f"lemma/{''.join(word.capitalize() for word in task.split('_'))}-v0"


def task_rank(task: str) -> tuple[int, str]:
    """Return the sort key of a task: tasks of suites in order, others by name.

    It does not depend on registered tasks, so that results can be read without the
    plugins of their tasks.
    """
    return (LISTED.index(task), "") if task in LISTED else (len(LISTED), task)


def in_order(tasks: Iterable[str]) -> tuple[str, ...]:
    """Return distinct names of tasks in the order of :func:`task_rank`."""
    return tuple(sorted(set(tasks), key=task_rank))
