"""Blind instructions: for evaluation alone, read by nothing that learns.

Their author had read none of this project's templates, rules or results. They are kept
as the author wrote them, apart from the templates of the other kinds, and compressed,
so that no search through the sources shows them to developers of a reader.
"""

import gzip
import hashlib
import json
import re
from collections.abc import Iterable
from functools import lru_cache
from importlib.resources import files
from typing import Any

from lemma.core.errors import InvalidConfigError, shown
from lemma.core.seeding import stream
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.template import (
    BLIND,
    EVALUATION_KINDS,
    KINDS,
    GoalPairs,
    Template,
)

_FOR_TRAINING = "train"
_SLOT = re.compile(r"\{(pick|place)([12]?)\}")
_ROLES = {"pick": "top", "place": "bottom"}
_BOTTOMS = {"on_pad": "pad", "on_cube": "cube"}


def has_blind(task: str, split: str) -> bool:
    """Return whether instances have blind instructions: the suite's, for evaluation.

    Args:
        task: Name of the task.
        split: Name of the split; ``"train"`` has none.
    """
    return split != _FOR_TRAINING and task in _as_written()


def check_blind(task: str, split: str) -> None:
    """Check that instances have blind instructions.

    Raises:
        InvalidConfigError: They have none.
    """
    if not has_blind(task, split):
        raise InvalidConfigError(
            f"Instances of task {task!r} in split {split!r} have no {BLIND!r} "
            f"instruction: those are for evaluation, of {', '.join(_as_written())} in "
            f"any split but {_FOR_TRAINING!r}. Choose {', '.join(KINDS)}, or "
            "another split."
        )


def kinds_of(tasks: Iterable[str], split: str) -> tuple[str, ...]:
    """Return the kinds of instructions that instances of all the tasks have.

    Args:
        tasks: Names of tasks.
        split: Name of the split.
    """
    every = all(has_blind(task, split) for task in tasks)
    return EVALUATION_KINDS if every else KINDS


def blind_templates(task: str) -> tuple[Template, ...]:
    """Return the blind templates of a task of the suite.

    Args:
        task: Name of the task.
    """
    return tuple(map(_template, _as_written()[task]))


def instruction(instance: Instance, kind: str) -> str:
    """Return the sentence of one kind that an instance is asked for with.

    A blind one is drawn when it is asked for, from its own random stream. It is no part
    of the instance's data, so that other templates leave all digests as they are.

    Args:
        instance: The problem.
        kind: One of :data:`lemma.tasks.language.template.EVALUATION_KINDS`.

    Raises:
        InvalidConfigError: The instance has none of this kind.
    """
    text = instance.instructions.get(kind)
    if text is not None:
        return text
    if kind == BLIND and has_blind(instance.task, instance.split):
        key = (BENCHMARK_VERSION, instance.task, instance.split, instance.index)
        return _drawn(key, instance.goal.pairs)
    raise InvalidConfigError(
        f"Instance {instance.key} has no instruction of the kind {shown(kind)}, "
        f"only {', '.join(instance.instructions) or 'none at all'}."
    )


@lru_cache(maxsize=4096)
def _drawn(key: tuple[str, str, str, int], goal_pairs: GoalPairs) -> str:
    candidates = blind_templates(key[1])
    drawn = int(stream(*key, "language", BLIND).integers(len(candidates)))
    return candidates[drawn].render(goal_pairs)


def _template(written: dict[str, Any]) -> Template:
    """Return a template whose slots are written as ours.

    The author's ``{pick}`` and ``{place}`` are the colors of what goes on top and of
    what is below; ``goal`` has a triple of them and their relation for each ``On``.
    """

    def slot(found: re.Match[str]) -> str:
        return f"{{{_ROLES[found[1]]}{found[2]}.color}}"

    kinds = [("cube", _BOTTOMS[relation]) for _, relation, _ in written["goal"]]
    return Template.from_string(_SLOT.sub(slot, written["text"]), kinds)


def author_sha256() -> str:
    """Return the SHA-256 of what the author wrote, which fixes all drawn sentences."""
    return hashlib.sha256(_file()).hexdigest()


@lru_cache(maxsize=1)
def _as_written() -> dict[str, list[dict[str, Any]]]:
    """Return what the author wrote, by task."""
    found: dict[str, list[dict[str, Any]]] = json.loads(_file())
    return found


def _file() -> bytes:
    source = files("lemma.tasks.language") / "templates" / "blind.json.gz"
    return gzip.decompress(source.read_bytes())
