"""How long the expert takes for every frozen instance of the val and test splits.

A small table in the package, made by ``python scripts/expert_times.py``, through the
same path as ``lemma evaluate --policy oracle``. A policy's time is compared with it,
and a change of skills or physics changes it.
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
"""File in the package."""
TIMED_SPLITS = ("val", "test")


def expert_s(
    task: str, split: str, index: int, *, perturbed_start: bool = False
) -> float | None:
    """Return the simulated time that the expert takes for an instance [s].

    Args:
        task: Name of the task.
        split: Name of the list.
        index: Number in the list.
        perturbed_start: With its objects elsewhere.

    Returns:
        The time until it says ``stop``; None for splits and tasks that are not in the
        table.
    """
    if split not in TIMED_SPLITS or task not in _table()[split]:
        return None
    times = _table()[split][task]
    found: float = times["perturbed_s" if perturbed_start else "elapsed_s"][index]
    return found


def perturbed_start(instance: Instance) -> Instance:
    """Return a frozen instance with its objects a little elsewhere.

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
