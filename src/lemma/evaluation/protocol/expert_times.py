"""The expert's time for every frozen instance of the val and test splits.

The times are in a table in the package. ``python scripts/expert_times.py`` makes it, by
the code of ``lemma evaluate --policy oracle``. Reports compare a policy's times with
it. A change of skills or physics changes the table.
"""

import hashlib
import json
from functools import cache
from importlib.resources import files
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.evaluation.protocol.perturbed_starts import perturbed
from lemma.tasks.instance import Instance

TIMES = "expert_times.json"
"""Name of the table's file in the package."""
TIMED_SPLITS = ("val", "test")


def expert_s(
    task: str, split: str, index: int, *, perturbed_start: bool = False
) -> float | None:
    """Return the expert's simulated time for an instance [s].

    Args:
        task: Name of the task.
        split: Name of the list.
        index: Index in the list.
        perturbed_start: Whether to return the time from the perturbed start.

    Returns:
        The time until ``stop``; None for splits and tasks that are not in the table.
    """
    if split not in TIMED_SPLITS or task not in _table()[split]:
        return None
    times = _table()[split][task]
    found: float = times["perturbed_s" if perturbed_start else "elapsed_s"][index]
    return found


def perturbed_start(instance: Instance) -> Instance:
    """Return the perturbed start of a frozen instance.

    Raises:
        InvalidConfigError: Its split or task has no perturbed starts.
    """
    if instance.split not in TIMED_SPLITS:
        raise InvalidConfigError(
            f"Split {instance.split!r} has no perturbed starts; {TIMED_SPLITS} have."
        )
    if instance.task not in _table()[instance.split]:
        raise InvalidConfigError(
            f"Task {instance.task!r} has no perturbed starts; "
            f"{', '.join(_table()[instance.split])} have."
        )
    draw = _table()[instance.split][instance.task]["draw"][instance.index]
    return perturbed(instance, draw)


def times_sha256() -> str:
    """Return the SHA-256 of the table."""
    return hashlib.sha256(_bytes()).hexdigest()


@cache
def _bytes() -> bytes:
    return (files("lemma.evaluation.protocol") / TIMES).read_bytes()


@cache
def _table() -> dict[str, Any]:
    table: dict[str, Any] = json.loads(_bytes())
    return table
