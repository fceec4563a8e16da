"""Blind instructions, for evaluation alone; no training uses them.

Their author had not read this project's templates, rules or results. They are stored as
the author wrote them, separate from the templates of other kinds, and compressed, so
that developers of a language model do not find them by text search.
"""

import gzip
import hashlib
import json
import re
from collections.abc import Iterable
from functools import lru_cache
from importlib.resources import files
from typing import Any

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError, shown
from lemma.core.seeding import stream
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.relational import (
    check_relational,
    has_relational,
    relational,
)
from lemma.tasks.language.template import (
    ALL_KINDS,
    BLIND,
    EVALUATION_KINDS,
    KINDS,
    RELATIONAL,
    GoalPairs,
    Template,
)

_FOR_TRAINING = "train"
_SLOT = re.compile(r"\{(pick|place)([12]?)\}")
_ROLES = {"pick": "top", "place": "bottom"}
_BOTTOMS = {"on_pad": "pad", "on_cube": "cube"}


def has_blind(task: str, split: str) -> bool:
    """Return whether instances of a task and split have blind instructions.

    Args:
        task: Name of the task.
        split: Name of the split; ``"train"`` has none.
    """
    return split != _FOR_TRAINING and task in _as_written()


def check_blind(task: str, split: str) -> None:
    """Check that instances of a task and split have blind instructions.

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


def check_kind(kind: str, task: str, split: str) -> None:
    """Check that instances of a task and split have instructions of a kind.

    Raises:
        UnknownNameError: No such kind.
        InvalidConfigError: They have none of this kind.
    """
    known("kind of instruction", kind, ALL_KINDS)
    if kind == BLIND:
        check_blind(task, split)
    elif kind == RELATIONAL:
        check_relational(task)


def kinds_of(tasks: Iterable[str], split: str) -> tuple[str, ...]:
    """Return the protocol's kinds of instructions that all tasks have in a split.

    Args:
        tasks: Names of tasks.
        split: Name of the split.
    """
    every = all(has_blind(task, split) for task in tasks)
    return EVALUATION_KINDS if every else KINDS


def blind_templates(task: str) -> tuple[Template, ...]:
    """Return the blind templates of a task.

    Args:
        task: Name of a task with blind instructions.
    """
    return tuple(map(_template, _as_written()[task]))


def instruction(instance: Instance, kind: str) -> str:
    """Return the instruction of one kind of an instance.

    A blind or relational instruction is drawn on demand from its own random stream. It
    is not part of the instance's data, so that it does not affect any digest.

    Args:
        instance: The problem.
        kind: One of :data:`lemma.tasks.language.template.ALL_KINDS`.

    Raises:
        InvalidConfigError: The instance has none of this kind.
    """
    text = instance.instructions.get(kind)
    if text is not None:
        return text
    if kind == BLIND and has_blind(instance.task, instance.split):
        key = (BENCHMARK_VERSION, instance.task, instance.split, instance.index)
        return _drawn(key, instance.goal.pairs)
    if kind == RELATIONAL and has_relational(instance.task):
        return relational(instance)
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
    """Convert a template of the author's format.

    The author's ``{pick}`` and ``{place}`` are the colors of the upper and the lower
    object; ``goal`` has a triple of both and their relation for each ``On``.
    """

    def slot(found: re.Match[str]) -> str:
        return f"{{{_ROLES[found[1]]}{found[2]}.color}}"

    kinds = [("cube", _BOTTOMS[relation]) for _, relation, _ in written["goal"]]
    return Template.from_string(_SLOT.sub(slot, written["text"]), kinds)


def author_sha256() -> str:
    """Return the SHA-256 of the author's templates, which determine all sentences."""
    return hashlib.sha256(_file()).hexdigest()


@lru_cache(maxsize=1)
def _as_written() -> dict[str, list[dict[str, Any]]]:
    """Return the author's templates by task."""
    found: dict[str, list[dict[str, Any]]] = json.loads(_file())
    return found


def _file() -> bytes:
    source = files("lemma.tasks.language") / "templates" / "blind.json.gz"
    return gzip.decompress(source.read_bytes())
