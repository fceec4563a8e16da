"""Render a recipe: images of its keyframes.

The work is divided by the row groups of the recipe. One job writes the files of a
group, each whole or not at all. A run that was killed loses the groups it was working
on, and the next run continues there. The same recipe gives
the same bytes, wherever it was interrupted; for images, on machines that draw alike.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from time import perf_counter
from typing import Any, Protocol

from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.core.files import only_writer, sha256_of, write_json, write_text
from lemma.core.workers.pool import Engine
from lemma.core.workers.resumable import (
    PARTS,
    RECORD,
    Part,
    begin,
    check_same_job,
    do_missing,
)
from lemma.dataset.files import (
    CARD,
    MANIFEST,
    check_files,
    check_free,
    content_digest,
    listed_files,
)
from lemma.dataset.recipe.files import load, open_table, read_group, versions
from lemma.dataset.recipe.replay import check_versions
from lemma.dataset.recipe.schema import EpisodeRecord, perturbed_as
from lemma.dataset.rendered.shards import changed, read_manifest
from lemma.dataset.teleoperation import files_in
from lemma.tasks.instance import BENCHMARK_VERSION

_PERTURBED_NOTE = """
## Perturbed executions

These are no demonstrations and no part of the benchmark. Sub-tasks went wrong on
purpose (`lemma generate --perturb {perturb} --perturb-seed {perturb_seed}`). Labels are
what the expert would do in each state; what was done is in the columns `executed_*`.
"""


@dataclass(frozen=True, slots=True)
class Found:
    """A file that exists already."""

    about: dict[str, Any]
    """Versions and settings that decide its bytes."""
    digests: tuple[str, ...]
    """Digests of its episodes in the recipe."""
    rows: int
    """Keyframes or steps."""


class Form(Protocol):
    """A kind of files that are made from a recipe."""

    @property
    def name(self) -> str:
        """Name of the form: ``"keyframes"``."""
        ...

    def paths(self, split: str, name: str) -> tuple[str, ...]:
        """Return the files of a row group of the recipe, relative to the folder."""
        ...

    def about(self, versions: dict[str, str]) -> dict[str, Any]:
        """Return the settings and versions that decide the bytes."""
        ...

    def look(self, path: Path) -> Found:
        """Return the record that a file holds.

        Raises:
            DatasetError: It is damaged, or of another form or version.
        """
        ...

    def write(
        self,
        paths: Sequence[Path],
        records: Sequence[EpisodeRecord],
        digests: tuple[str, ...],
        about: dict[str, Any],
    ) -> None:
        """Write the files of some episodes.

        Args:
            paths: Files, in the order of :meth:`paths`.
            records: The episodes.
            digests: Their digests in the recipe.
            about: The description that :meth:`about` returned.
        """
        ...

    def card(self) -> str:
        """Return the README of the folder."""
        ...


@dataclass(frozen=True, kw_only=True)
class RenderConfig:
    """The settings of a rendering."""

    recipe: Path
    """Folder of the recipe. An export to LeRobot also takes a file of an episode that
    was led by hand, or a folder of such files."""
    out: Path
    """Folder to write."""
    tasks: tuple[str, ...] = ()
    """Names of tasks; all of the recipe if empty."""
    splits: tuple[str, ...] = ()
    """Names of splits; all of the recipe if empty."""

    def groups(self) -> list[tuple[Path, int, tuple[int, ...]]]:
        """Return the row groups of the recipe that are wanted: file, number, rows.

        A file of an episode that was led by hand is a group of one row.

        Raises:
            DatasetError: There is no recipe.
            InvalidConfigError: Tasks or splits are named of what was led by hand.
            UnknownNameError: The recipe has no such task or split.
        """
        led = files_in(self.recipe)
        if led and (self.tasks or self.splits):
            raise InvalidConfigError(
                "Episodes that were led by hand are chosen by their files, not by task "
                "or split. Leave --tasks and --splits out."
            )
        if led:
            return [(path, 0, (0,)) for path in led]
        groups = load(self.recipe).groups()
        for kind, names, valid in (
            ("task in this recipe", self.tasks, {path.stem for path, *_ in groups}),
            ("split in this recipe", self.splits, {p.parent.name for p, *_ in groups}),
        ):
            for name in names:
                if name not in valid:
                    raise UnknownNameError(kind, name, sorted(valid))
        return [
            (path, group, rows)
            for path, group, rows in groups
            if path.stem in (self.tasks or (path.stem,))
            and path.parent.name in (self.splits or (path.parent.name,))
        ]

    def episodes(self) -> int:
        """Return how many episodes are wanted."""
        return sum(len(rows) for *_, rows in self.groups())


@dataclass(frozen=True, slots=True)
class _Chunk:
    """The episodes of one row group of the recipe, and the files made from them."""

    source: Path
    group: int
    paths: tuple[Path, ...]
    digests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RenderSummary:
    """The outcome of a run."""

    episodes: int
    """Episodes of the order; all exist now."""
    rows: int
    """Keyframes, steps or frames of the whole folder."""
    made: int
    """Episodes that this run made."""
    seconds: float
    """Time that this run took [s]."""
    size_mb: float
    """Size of all files of the folder [MB]."""


def render(
    order: RenderConfig,
    form: Form,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> RenderSummary:
    """Write the files that are missing.

    Args:
        order: Options of the rendering.
        form: In which form.
        engine: Workers that run the jobs.
        advance: Is told how many episodes are done already, then of each further one.

    Returns:
        The outcome.

    Raises:
        DatasetError: The recipe cannot be read here, what is there was made from
            another one or by another version, or something cannot be written.
        UnknownNameError: The recipe has no such task or split.
    """
    start = perf_counter()
    groups = order.groups()
    perturbed: dict[str, str] = {}
    for source in dict.fromkeys(source for source, *_ in groups):
        found = open_table(source)[1]
        check_versions(found)
        perturbed = perturbed_as(found)
    check_files(order.recipe, partial=True)
    about = form.about({**versions(BENCHMARK_VERSION), **perturbed})
    chunks = list(_chunks(order, form, groups))
    total = sum(len(chunk.digests) for chunk in chunks)
    with only_writer(order.out):
        known = _known_files(order.out, form)
        there = _look(order.out, form, about)
        sums = _check_sums(order.out, there, known)
        parts = []
        for chunk in chunks:
            is_done = _is_there(chunk, there)
            job = (form, _absolute(chunk), about)
            parts.append(Part(job, len(chunk.digests), is_done))
            for path in () if is_done else chunk.paths:
                sums.pop(path, None)
        begin(order.out, RECORD, about)
        for part, _ in do_missing(parts, render_chunk, engine, advance):
            advance(part.size)
        rmtree(order.out / PARTS, ignore_errors=True)
        rows, size = _write_manifest(order.out, form, about, sums)
        note = _PERTURBED_NOTE.format(**perturbed) if perturbed else ""
        write_text(order.out / CARD, form.card() + note)
    made = sum(part.size for part in parts if not part.is_done)
    seconds = perf_counter() - start
    return RenderSummary(total, rows, made, seconds, size / 1e6)


def _absolute(chunk: _Chunk) -> _Chunk:
    """Return a chunk with paths that hold in workers with another working folder."""
    paths = tuple(path.absolute() for path in chunk.paths)
    return replace(chunk, source=chunk.source.absolute(), paths=paths)


def render_chunk(form: Form, chunk: _Chunk, about: dict[str, Any]) -> None:
    """Make the files of one row group."""
    records = read_group(chunk.source, chunk.group)
    form.write(chunk.paths, records, chunk.digests, about)


def _chunks(
    order: RenderConfig, form: Form, groups: list[tuple[Path, int, tuple[int, ...]]]
) -> Iterator[_Chunk]:
    """Yield the work of each row group.

    Raises:
        DatasetError: The recipe is not complete.
    """
    files = listed_files(order.recipe)
    taken: dict[Path, int] = {}
    # Groups of a file come in order, so their rows are counted from the first one.
    for source, group, rows in groups:
        name = source.relative_to(order.recipe).as_posix()
        first = taken.get(source, 0)
        taken[source] = first + len(rows)
        digests = files.get(name, {}).get("digests", [])[first : taken[source]]
        if len(digests) != len(rows):
            raise DatasetError(
                f"{MANIFEST} does not say what is in {source}: the recipe is not "
                "complete. Run 'lemma generate' again."
            )
        split, stem = source.parent.name, f"{source.stem}-{group:03d}"
        paths = tuple(order.out / path for path in form.paths(split, stem))
        yield _Chunk(source, group, paths, tuple(digests))


def _look(folder: Path, form: Form, about: dict[str, Any]) -> dict[Path, Found]:
    """Return the files that exist, and check that this job would write the same.

    Raises:
        DatasetError: One is of another job, or damaged.
    """
    there = {}
    for pattern in form.paths("*", "*"):
        for path in sorted(folder.glob(pattern)):
            there[path] = form.look(path)
            check_same_job(path, there[path].about, about)
    return there


def _is_there(chunk: _Chunk, there: dict[Path, Found]) -> bool:
    """Return whether the files of a chunk are there, with all its episodes.

    Raises:
        DatasetError: They were made from other episodes.
    """
    found = [there[path].digests for path in chunk.paths if path in there]
    for path, digests in zip(chunk.paths, found, strict=False):
        # The recipe may have grown since the file was written.
        if digests != chunk.digests[: len(digests)]:
            raise DatasetError(
                f"{path} was made from other episodes. Choose a new folder, or delete "
                "this one."
            )
    return len(found) == len(chunk.paths) and all(d == chunk.digests for d in found)


def _known_files(folder: Path, form: Form) -> dict[str, dict[str, Any]]:
    """Return the entries of the manifest of an earlier run, if there is one.

    Raises:
        DatasetError: The folder holds something else.
    """
    if (folder / MANIFEST).exists():
        return read_manifest(folder, form.name)
    begun = any(any(folder.glob(pattern)) for pattern in form.paths("*", "*"))
    check_free(folder, begun=begun)
    return {}


def _check_sums(
    folder: Path, there: Iterable[Path], known: dict[str, dict[str, Any]]
) -> dict[Path, str]:
    """Return the SHA-256 of files, and check it where the manifest knows them.

    Raises:
        DatasetError: One was changed since it was written.
    """
    sums = {}
    for path in there:
        sums[path] = sha256_of(path)
        entry = known.get(path.relative_to(folder).as_posix())
        if entry is not None and entry["sha256"] != sums[path]:
            raise DatasetError(changed(path))
    return sums


def _write_manifest(
    folder: Path, form: Form, about: dict[str, Any], sums: dict[Path, str]
) -> tuple[int, int]:
    """Write the checksums of all files; return their rows and bytes."""
    files: dict[str, dict[str, Any]] = {}
    rows = 0
    for pattern in form.paths("*", "*"):
        rows = 0
        for path in sorted(folder.glob(pattern)):
            found = form.look(path)
            rows += found.rows
            files[path.relative_to(folder).as_posix()] = {
                "sha256": sums.get(path) or sha256_of(path),
                "content_sha256": content_digest(found.digests),
                "bytes": path.stat().st_size,
                "episodes": len(found.digests),
                "rows": found.rows,
            }
    write_json(folder / MANIFEST, {"form": form.name, "about": about, "files": files})
    return rows, sum(entry["bytes"] for entry in files.values())
