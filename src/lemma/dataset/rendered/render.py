"""Rendering of a recipe: images of its keyframes.

Each job writes the files of one row group of the recipe, each file completely or not at
all. A killed run loses only unfinished groups; the next run continues. The same recipe
gives the same bytes with or without interruptions; for images this holds for machines
with the same rendering.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from time import perf_counter
from typing import Any

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
    card,
    check_files,
    check_free,
    check_sum,
    content_digest,
    listed_files,
    read_manifest,
)
from lemma.dataset.recipe.files import load, open_table, read_group, versions
from lemma.dataset.recipe.replay import check_versions
from lemma.dataset.recipe.schema import perturbed_as
from lemma.dataset.rendered import keyframes
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.keyframes import FORM, SUFFIX, Header, KeyframeFile
from lemma.dataset.teleoperation import files_in
from lemma.tasks.instance import BENCHMARK_VERSION


@dataclass(frozen=True, kw_only=True)
class RenderConfig:
    """The settings of a rendering."""

    recipe: Path
    """Folder of the recipe. An export to LeRobot also takes a file of an episode that
    was led by hand, or a folder of such files."""
    out: Path
    """Output folder."""
    tasks: tuple[str, ...] = ()
    """Names of tasks; all of the recipe if empty."""
    splits: tuple[str, ...] = ()
    """Names of splits; all of the recipe if empty."""

    def groups(self) -> list[tuple[Path, int, tuple[int, ...]]]:
        """Return the selected row groups of the recipe: file, number, rows.

        A file of an episode that was led by hand is a group of one row.

        Raises:
            DatasetError: There is no recipe.
            InvalidConfigError: Tasks or splits are named for episodes led by hand.
            UnknownNameError: The recipe has no such task or split.
        """
        led = files_in(self.recipe)
        if led and (self.tasks or self.splits):
            raise InvalidConfigError(
                "Episodes that were led by hand are selected by their files, not by "
                "task or split. Leave out --tasks and --splits."
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
        """Return the number of selected episodes."""
        return sum(len(rows) for *_, rows in self.groups())


@dataclass(frozen=True, slots=True)
class _Chunk:
    """The episodes of one row group of the recipe, and their output files."""

    source: Path
    group: int
    paths: tuple[Path, ...]
    digests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RenderSummary:
    """The outcome of a run."""

    episodes: int
    """Number of selected episodes, which all exist now."""
    rows: int
    """Number of keyframes, steps or frames in the folder."""
    made: int
    """Number of episodes that this run made."""
    seconds: float
    """Duration of this run [s]."""
    size_mb: float
    """Size of all files of the folder [MB]."""


def render(
    order: RenderConfig,
    form: KeyframeForm,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> RenderSummary:
    """Write missing files.

    Args:
        order: Options of the rendering.
        form: Options of the images.
        engine: Workers that run the jobs.
        advance: Called with the numbers of existing and of newly finished episodes.

    Returns:
        The outcome.

    Raises:
        DatasetError: The recipe cannot be read here, existing files were made from
            another recipe or by another version, or a file cannot be written.
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
    header = form.header({**versions(BENCHMARK_VERSION), **perturbed})
    chunks = list(_chunks(order, groups))
    with only_writer(order.out):
        there, sums = _look(order.out, header.about())
        parts = []
        for chunk in chunks:
            is_done = _is_there(chunk, there)
            job = (form, _absolute(chunk), header)
            parts.append(Part(job, len(chunk.digests), is_done))
            for path in () if is_done else chunk.paths:
                sums.pop(path, None)
        begin(order.out, RECORD, header.about())
        for part, _ in do_missing(parts, render_chunk, engine, advance):
            advance(part.size)
        rmtree(order.out / PARTS, ignore_errors=True)
        files = _listed(order.out, sums)
        about = {"form": FORM, "about": header.about(), "files": files}
        write_json(order.out / MANIFEST, about)
        text = card(
            FORM, columns=keyframes.describe(), width=form.width, height=form.height
        )
        note = card(f"{FORM}_perturbed", **perturbed) if perturbed else ""
        write_text(order.out / CARD, text + note)
    return RenderSummary(
        episodes=sum(part.size for part in parts),
        rows=sum(entry["rows"] for entry in files.values()) // len(keyframes.PARTS),
        made=sum(part.size for part in parts if not part.is_done),
        seconds=perf_counter() - start,
        size_mb=sum(entry["bytes"] for entry in files.values()) / 1e6,
    )


def _absolute(chunk: _Chunk) -> _Chunk:
    """Return a chunk with absolute paths, for workers with another working folder."""
    paths = tuple(path.absolute() for path in chunk.paths)
    return replace(chunk, source=chunk.source.absolute(), paths=paths)


def render_chunk(form: KeyframeForm, chunk: _Chunk, header: Header) -> None:
    """Write the files of one row group."""
    records = read_group(chunk.source, chunk.group)
    form.write(chunk.paths, records, chunk.digests, header)


def _chunks(
    order: RenderConfig, groups: list[tuple[Path, int, tuple[int, ...]]]
) -> Iterator[_Chunk]:
    """Yield the work of each row group.

    Raises:
        DatasetError: The recipe is not complete.
    """
    files = listed_files(order.recipe)
    rows_so_far: dict[Path, int] = {}
    # Groups of a file are in order, so rows of a group follow those of the former ones.
    for source, group, rows in groups:
        name = source.relative_to(order.recipe).as_posix()
        first = rows_so_far.get(source, 0)
        rows_so_far[source] = first + len(rows)
        digests = files.get(name, {}).get("digests", [])[first : rows_so_far[source]]
        if len(digests) != len(rows):
            raise DatasetError(
                f"{MANIFEST} has no entry for {source}: the recipe is not complete. "
                "Run 'lemma generate' again."
            )
        place = Path(source.parent.name, f"{source.stem}-{group:03d}{SUFFIX}")
        paths = tuple(order.out / part / place for part in keyframes.PARTS)
        yield _Chunk(source, group, paths, tuple(digests))


def _is_there(chunk: _Chunk, there: dict[Path, Header]) -> bool:
    """Return whether the files of a chunk exist with all its episodes.

    Raises:
        DatasetError: The files were made from other episodes.
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


def _files(folder: Path) -> list[Path]:
    parts = (sorted(folder.glob(f"{part}/*/*{SUFFIX}")) for part in keyframes.PARTS)
    return [path for paths in parts for path in paths]


def _look(
    folder: Path, about: dict[str, Any]
) -> tuple[dict[Path, Header], dict[Path, str]]:
    """Return headers and checksums of the files that exist.

    Raises:
        DatasetError: A file is of another job, damaged, or changed since it was
            written, or the folder contains something else.
    """
    known: dict[str, dict[str, Any]] = {}
    paths = _files(folder)
    if (folder / MANIFEST).exists():
        known = read_manifest(folder, FORM)
    else:
        check_free(folder, begun=bool(paths))
    headers, sums = {}, {}
    for path in paths:
        headers[path] = KeyframeFile(path).header
        check_same_job(path, headers[path].about(), about)
        entry = known.get(path.relative_to(folder).as_posix())
        sums[path] = check_sum(path, entry, keyframes.WRITTEN_BY)
    return headers, sums


def _listed(folder: Path, sums: dict[Path, str]) -> dict[str, dict[str, Any]]:
    """Return the manifest's entries of all files; compute unknown checksums."""
    files = {}
    for path in _files(folder):
        header = KeyframeFile(path).header
        files[path.relative_to(folder).as_posix()] = {
            "sha256": sums.get(path) or sha256_of(path),
            "content_sha256": content_digest(header.digests),
            "bytes": path.stat().st_size,
            "episodes": len(header.digests),
            "rows": sum(header.keyframes),
        }
    return files
