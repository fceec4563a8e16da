"""Write a recipe: resumable at any moment, the same bytes however it was interrupted.

Every episode is first written as a part of its own, whole or not at all. When all parts
of a file are there, they are put together in order, and the parts go. What a killed run
leaves behind is therefore always a prefix of work, never a wrong file.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree

import pyarrow as pa

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.dataset.card import write_card
from lemma.dataset.engines import Engine
from lemma.dataset.files import (
    open_table,
    sha256_of,
    versions,
    write_json,
    write_table,
)
from lemma.dataset.record import record_episode
from lemma.dataset.schema import SCHEMA, EpisodeRecord, from_table, to_table
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.suite import SUITE, load_instance

MANIFEST = "manifest.json"
_PARTS = ".parts"


@dataclass(frozen=True, kw_only=True)
class Order:
    """What to generate."""

    out: Path
    """Folder of the recipe."""
    tasks: tuple[str, ...] = SUITE
    """Names of tasks of the suite."""
    splits: tuple[str, ...] = tuple(SPLITS)
    """Names of splits."""
    episodes: int | None = None
    """Only the first so many of every list; all if None."""

    def __post_init__(self) -> None:
        """Check the names."""
        for task in self.tasks:
            if task not in SUITE:
                raise UnknownNameError("task", task, SUITE)
        for split in self.splits:
            if split not in SPLITS:
                raise UnknownNameError("split", split, SPLITS)

    def count(self, split: str) -> int:
        """Return how many episodes of a split are wanted."""
        return SPLITS[split] if self.episodes is None else self.episodes

    @property
    def total(self) -> int:
        """Return how many episodes there will be."""
        return len(self.tasks) * sum(self.count(split) for split in self.splits)


def recipe_file(folder: Path, split: str, task: str) -> Path:
    """Return where the episodes of one task and split are."""
    return folder / split / f"{task}.parquet"


def generate(
    order: Order, engine: Engine, advance: Callable[[int], None] = lambda count: None
) -> None:
    """Write what is missing of a recipe.

    Args:
        order: What is wanted.
        engine: Where to work.
        advance: Told how many episodes were done since it was last told.

    Raises:
        DatasetError: Something cannot be written, or what is there is of another
            version, or the expert failed.
    """
    about = versions(BENCHMARK_VERSION)
    missing = []
    for split in order.splits:
        for task in order.tasks:
            path = recipe_file(order.out, split, task)
            if path.exists():
                _check_same(path, about, order.count(split))
                advance(order.count(split))
                continue
            parts = _parts_of(order.out, split, task)
            for index in range(order.count(split)):
                if _part(parts, index).exists():
                    advance(1)
                else:
                    missing.append((task, split, index, str(parts), about))
    counts: dict[tuple[str, str], int] = {}
    for task, split, *_ in missing:
        counts[task, split] = counts.get((task, split), 0) + 1
    for task, split in engine.run(generate_part, missing):
        advance(1)
        counts[task, split] -= 1
        if counts[task, split] == 0:
            _put_together(order, split, task, about)
    for split in order.splits:
        for task in order.tasks:
            if not recipe_file(order.out, split, task).exists():
                _put_together(order, split, task, about)
    rmtree(order.out / _PARTS, ignore_errors=True)
    _write_manifest(order.out, about)
    write_card(order.out, about)


def generate_part(
    task: str, split: str, index: int, parts: str, about: dict[str, str]
) -> tuple[str, str]:
    """Write one episode as a part; return its task and split.

    Raises:
        DatasetError: The expert failed, so this is not the version that froze the list.
    """
    record = record_episode(load_instance(task, split, index))
    if not record.success:
        raise DatasetError(
            f"The expert failed on {record.key}: {record.failure}. Frozen instances "
            "are solved by the version that froze them; see 'lemma doctor'."
        )
    write_table(_part(Path(parts), index), to_table([record]), about)
    return task, split


def _parts_of(folder: Path, split: str, task: str) -> Path:
    return folder / _PARTS / f"{split}-{task}"


def _part(parts: Path, index: int) -> Path:
    return parts / f"{index:05d}.parquet"


def _check_same(path: Path, about: dict[str, str], count: int) -> None:
    file, found = open_table(path)
    differing = [k for k in about if k != "revision" and found.get(k) != about[k]]
    if differing:
        what = ", ".join(f"{k} {found.get(k)} instead of {about[k]}" for k in differing)
        raise DatasetError(
            f"{path} was written by another version: {what}. Its states would not fit "
            "what is generated now. Choose a new folder, or delete this one."
        )
    if file.metadata.num_rows != count:
        raise DatasetError(
            f"{path} holds {file.metadata.num_rows} episodes, but {count} are wanted. "
            "Choose a new folder, or delete this file."
        )


def _put_together(order: Order, split: str, task: str, about: dict[str, str]) -> None:
    parts = _parts_of(order.out, split, task)
    tables = [
        open_table(_part(parts, index))[0].read() for index in range(order.count(split))
    ]
    table = pa.concat_tables(tables).cast(SCHEMA)
    write_table(recipe_file(order.out, split, task), table, about)
    rmtree(parts, ignore_errors=True)


def content_digest(records: list[EpisodeRecord]) -> str:
    """Return the SHA-256 of what the records say, whatever file they are in."""
    digests = "".join(record.digest() for record in records)
    return hashlib.sha256(digests.encode()).hexdigest()


def _write_manifest(folder: Path, about: dict[str, str]) -> None:
    files = {}
    for path in sorted(folder.glob("*/*.parquet")):
        records = from_table(open_table(path)[0].read())
        files[path.relative_to(folder).as_posix()] = {
            "sha256": sha256_of(path),
            "content_sha256": content_digest(records),
            "episodes": len(records),
        }
    write_json(folder / MANIFEST, {"versions": about, "files": files})
