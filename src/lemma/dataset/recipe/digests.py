"""The digest of every episode of the suite, 128 bits each.

A recipe that anybody generates from the frozen lists can be compared with what the
authors' came to, episode by episode, without fetching anything.
"""

import hashlib
import json
from collections.abc import Iterable
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.core.files import write_json, write_text
from lemma.dataset.files import MANIFEST, listed_files, listed_versions
from lemma.dataset.recipe.schema import executions, perturbed_as

_HERE = files("lemma.dataset") / "digests"
_BINDING = ("benchmark", "format", "mujoco")


def shorten(digest: str) -> str:
    """Return the first 128 bits of a SHA-256, as hexadecimal digits."""
    return digest[:32]


def content_digest(digests: Iterable[str]) -> str:
    """Return the SHA-256 of a list of digests: of what a file or a split says."""
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def export(folder: Path, out: Path) -> dict[str, Any]:
    """Write the digests of a recipe as files to be committed.

    Args:
        folder: The recipe.
        out: Where they go, ``src/lemma/dataset/digests``.

    Returns:
        The manifest that was written beside them.

    Raises:
        DatasetError: The recipe holds perturbed executions.
    """
    versions = listed_versions(folder)
    if perturbed_as(versions):
        raise DatasetError(
            f"{folder} holds {executions(versions)}, which are no part of the "
            "benchmark. Export the digests of demonstrations."
        )
    lists: dict[str, dict[str, list[str]]] = {}
    for name, entry in listed_files(folder).items():
        split, _, task = name.removesuffix(".parquet").partition("/")
        lists.setdefault(split, {})[task] = entry["digests"]
    for split, tasks in lists.items():
        for task, digests in tasks.items():
            write_text(out / f"{task}-{split}.txt", "\n".join(digests) + "\n")
    manifest = {
        "versions": {name: versions[name] for name in (*_BINDING, "revision")},
        "splits": {
            split: {
                "episodes": sum(len(digests) for digests in tasks.values()),
                "sha256": content_digest(
                    [d for task in sorted(tasks) for d in tasks[task]]
                ),
            }
            for split, tasks in lists.items()
        },
    }
    write_json(out / MANIFEST, manifest)
    return manifest


def differing(folder: Path) -> list[str] | None:
    """Return which episodes of a recipe are not what the authors' came to.

    Args:
        folder: The recipe.

    Returns:
        Task, split and index of each: ``"stack/test/3"``; empty if all are equal, None
        if the authors have made none of its lists, such as those of a user's task.
    """
    found: list[str] | None = None
    for name, entry in listed_files(folder).items():
        split, _, task = name.removesuffix(".parquet").partition("/")
        if not (_HERE / f"{task}-{split}.txt").is_file():
            continue
        pairs = zip(entry["digests"], expected_digests(task, split), strict=False)
        others = [i for i, (mine, theirs) in enumerate(pairs) if mine != theirs]
        found = [*(found or []), *(f"{task}/{split}/{i}" for i in others)]
    return found


@lru_cache
def expected_digests(task: str, split: str) -> tuple[str, ...]:
    """Return what the episodes of a task and split must come to, in order.

    Raises:
        UnknownNameError: There is no such list.
    """
    source = _HERE / f"{task}-{split}.txt"
    if not source.is_file():
        names = sorted(p.name.removesuffix(".txt") for p in _HERE.iterdir())
        raise UnknownNameError("list of digests", f"{task}-{split}", names)
    return tuple(source.read_text(encoding="ascii").split())


@lru_cache
def digest_manifest() -> dict[str, Any]:
    """Return the versions that the digests are of, and the SHA-256 of every split.

    Raises:
        DatasetError: This package was built without them.
    """
    source = _HERE / MANIFEST
    if not source.is_file():
        raise DatasetError(
            "This package holds no digests of the recipe. Install a released version, "
            "or make them: scripts/make_recipe.py."
        )
    manifest: dict[str, Any] = json.loads(source.read_text(encoding="utf-8"))
    return manifest
