"""How long the expert takes for every frozen instance of the val and test splits.

A small table in the package, made by ``python scripts/expert_times.py``, through the
same path as ``lemma evaluate --policy oracle``. A policy's time is compared with it,
and a change of skills or physics changes it.
"""

import hashlib
import json
from functools import cache, partial
from importlib.resources import files
from typing import Any

from lemma.core.errors import InvalidConfigError, SamplingError
from lemma.core.parallel import Engine
from lemma.evaluation.run.perturbed_starts import is_alike, perturbed
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, load_instance, task_named

TIMES = "expert_times.json"
"""File in the package."""
TIMED_SPLITS = ("val", "test")
PLACES = 3
"""Decimals of times [s] in results: milliseconds."""
_DRAWS = 200
_CHUNK = 10


def expert_s(
    task: str, split: str, index: int, *, perturbed_start: bool = False
) -> float | None:
    """Return the simulated time that the expert takes for an instance [s].

    Args:
        task: Name of the task.
        split: Of the list.
        index: Number in the list.
        perturbed_start: With its objects elsewhere.

    Returns:
        The time until it says ``stop``; None for splits that are not in the table.
    """
    if split not in TIMED_SPLITS:
        return None
    times = _table()[split][task]
    found: float = times["perturbed_s" if perturbed_start else "elapsed_s"][index]
    return found


def perturbed_start(instance: Instance) -> Instance:
    """Return a frozen instance with its objects a little elsewhere.

    Raises:
        InvalidConfigError: Its split has no perturbed starts.
    """
    if instance.split not in TIMED_SPLITS:
        raise InvalidConfigError(
            f"Split {instance.split!r} has no perturbed starts; {TIMED_SPLITS} have."
        )
    draw = _table()[instance.split][instance.task]["draw"][instance.index]
    return perturbed(instance, draw)


def times_sha256() -> str:
    """Return the SHA-256 of the table."""
    return hashlib.sha256(_bytes()).hexdigest()


def time_expert(task: str, split: str, index: int) -> tuple[float, int, float]:
    """Let the expert solve an instance, and find its perturbed start.

    Returns:
        Its time [s], the draw of the perturbed start, and the time for that [s].

    Raises:
        SamplingError: It fails, or no perturbed start was found.
    """
    instance = load_instance(task, split, index)
    elapsed = _solved_s(instance)
    if elapsed is None:
        raise SamplingError(
            f"The expert does not solve {instance.key}. Freeze the instances anew."
        )
    for draw in range(_DRAWS):
        moved = perturbed(instance, draw)
        if is_alike(moved.scene, instance.scene):
            moved_s = _solved_s(moved)
            if moved_s is not None:
                return elapsed, draw, moved_s
    raise SamplingError(
        f"None of {_DRAWS} perturbed starts of {instance.key} is the same problem. "
        "Move things less."
    )


def time_all(engine: Engine) -> dict[str, Any]:
    """Return the whole table, made anew."""
    jobs = [
        (task, split, range(start, min(start + _CHUNK, SPLITS[split])))
        for split in TIMED_SPLITS
        for task in SUITE
        for start in range(0, SPLITS[split], _CHUNK)
    ]
    found: dict[tuple[str, str, int], tuple[float, int, float]] = {}
    for group in engine.run(_time_group, jobs):
        found.update(group)
    return {
        split: {
            task: dict(
                zip(
                    ("elapsed_s", "draw", "perturbed_s"),
                    map(list, zip(*listed, strict=True)),
                    strict=True,
                )
            )
            for task in SUITE
            for listed in [[found[task, split, i] for i in range(SPLITS[split])]]
        }
        for split in TIMED_SPLITS
    }


def _time_group(
    task: str, split: str, indices: range
) -> dict[tuple[str, str, int], tuple[float, int, float]]:
    each = partial(time_expert, task, split)
    return {(task, split, index): each(index) for index in indices}


def _solved_s(instance: Instance) -> float | None:
    """Return the time of the expert [s]; None if it needs more than is promised."""
    (play,) = roll_out([Rollout(instance)], Player.load(PolicySpec(ORACLE)), 1)
    promised = task_named(instance.task).subtasks
    if not play.success or len(play.steps) != promised:
        return None
    return round(play.episode.elapsed_s, PLACES)


@cache
def _bytes() -> bytes:
    return (files("lemma.evaluation.run") / TIMES).read_bytes()


@cache
def _table() -> dict[str, Any]:
    table: dict[str, Any] = json.loads(_bytes())
    return table
