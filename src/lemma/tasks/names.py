"""Names of tasks: those of suites, their order, and what Gymnasium calls them.

Imports nothing, so that ``import lemma`` can register the suites at once.
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
"""How much varies on a rung: objects alone; robots as well; and distractors besides."""


def rung_task(rung: str, degree: str) -> str:
    """Return the task of a rung at a degree: ``"lift_fixed"``, ``"lift"`` in full."""
    return rung if degree == DEGREES[-1] else f"{rung}_{degree}"


LADDER = tuple(rung_task(rung, degree) for rung in RUNGS for degree in DEGREES)
"""The 24 tasks of the suite ``ladder``; four of them are of the suite ``lemma``."""
FAMILIES = ("relay", "line", "carousel", "sort", "tower", "exchange", "bridge")
"""The families of the suite ``teams``, for three and four robots."""
SUITES = {"lemma": SUITE, "ladder": LADDER, "teams": FAMILIES}
"""Sets of tasks with frozen lists, by name."""
LISTED = tuple(dict.fromkeys(task for suite in SUITES.values() for task in suite))
"""Every task with frozen lists, in the order in which tables have them."""


def gym_id(task: str) -> str:
    """Return Gymnasium's name of a task: ``"lemma/PokeStack-v0"``."""
    return f"lemma/{''.join(word.capitalize() for word in task.split('_'))}-v0"


def task_rank(task: str) -> tuple[int, str]:
    """Return what tasks are sorted by: those of suites in order, then the alphabet.

    It does not depend on what is registered, so that results can be read without the
    plugin that their tasks are from.
    """
    return (LISTED.index(task), "") if task in LISTED else (len(LISTED), task)


def in_order(tasks: Iterable[str]) -> tuple[str, ...]:
    """Return names of tasks, each once, the suite's first."""
    return tuple(sorted(set(tasks), key=task_rank))
