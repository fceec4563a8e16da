"""Generation of a recipe; it can be interrupted at any time and gives the same bytes.

Every episode is first written to its own file, a part, completely or not at all. When
all parts of a file exist, they are merged in order and deleted, so a killed run never
leaves a wrong file.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from time import perf_counter
from typing import Any

import pyarrow as pa

from lemma.core.errors import DatasetError, InvalidConfigError, SamplingError
from lemma.core.files import (
    only_writer,
    read_json,
    sha256_of,
    write_json,
    write_text,
)
from lemma.core.workers.pool import Engine
from lemma.core.workers.resources import peak_memory_mb
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
    check_free,
    check_sum,
    content_digest,
    listed_files,
    listed_versions,
    shorten,
)
from lemma.dataset.recipe.files import (
    open_table,
    read_table,
    versions,
    write_table,
)
from lemma.dataset.recipe.record import (
    described,
    perturbation_of,
    record_episode,
    record_perturbed,
)
from lemma.dataset.recipe.schema import EpisodeRecord, describe, from_table, to_table
from lemma.expert.disturbances import Perturbation
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS, splits_of
from lemma.tasks.suite import FREE_SPLIT, SUITE, TASKS, check_split, load_instance

_SHOWN = 5
"""Number of failures that a message lists."""


@dataclass(frozen=True, kw_only=True)
class GenerateConfig:
    """The settings of a recipe."""

    out: Path
    """Folder of the recipe."""
    tasks: tuple[str, ...] = SUITE
    """Names of tasks, including user-defined ones."""
    splits: tuple[str, ...] = tuple(SPLITS)
    """Names of splits; ``"free"`` samples instances with seeds 0, 1, ..."""
    episodes: int | None = None
    """Number of episodes of every list, from the first; None for all. Split ``"free"``
    needs it."""
    perturb: Perturbation | None = None
    """Perturbation of sub-tasks, for recovery states; None for demonstrations."""

    def __post_init__(self) -> None:
        """Check the names and the number.

        Raises:
            UnknownNameError: No such task or split.
            InvalidConfigError: The number is below 1, or missing for split ``"free"``.
        """
        for task in self.tasks:
            for split in self.splits:
                check_split(task, split)
        if self.episodes is not None and self.episodes < 1:
            raise InvalidConfigError(
                f"Episodes per task and split are at least 1, not {self.episodes}."
            )
        if self.perturb is not None:
            for task in self.tasks:
                TASKS[task].check_in_turns()
        if self.episodes is None and FREE_SPLIT in self.splits:
            raise InvalidConfigError(
                f"Split {FREE_SPLIT!r} is sampled without limit. Give the number of "
                "episodes of each task with --episodes."
            )

    def count(self, task: str, split: str) -> int:
        """Return the number of episodes of a task and split."""
        every = splits_of(task).get(split, self.episodes or 0)
        return every if self.episodes is None else min(self.episodes, every)

    @property
    def total(self) -> int:
        """The total number of episodes."""
        return sum(
            self.count(task, split) for task in self.tasks for split in self.splits
        )


@dataclass(frozen=True, slots=True)
class GenerateSummary:
    """The outcome of a run."""

    episodes: int
    """Number of requested episodes, which all exist now."""
    made: int
    """Number of episodes that this run made."""
    seconds: float
    """Duration of this run [s]."""
    size_mb: float
    """Size of the requested files [MB]."""
    worker_mb: float
    """Peak memory of a worker [MB]; 0 without work."""


@dataclass(frozen=True, slots=True)
class _File:
    """One requested file."""

    task: str
    split: str
    path: Path
    parts: tuple[Path, ...]
    """Files of its episodes, one each, until all exist."""
    there: int
    """Number of episodes that the file already contains."""


def recipe_file(folder: Path, split: str, task: str) -> Path:
    """Return the path of the file with the episodes of a task and split."""
    return folder / split / f"{task}.parquet"


def generate(
    order: GenerateConfig,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> GenerateSummary:
    """Write the episodes that a recipe lacks.

    Args:
        order: The settings.
        engine: Workers that run the jobs.
        advance: Called with the numbers of existing and of newly finished episodes.

    Returns:
        The outcome.

    Raises:
        DatasetError: A file cannot be written, an existing one is damaged or of another
            version, another process writes to the folder, or the expert failed.
    """
    start = perf_counter()
    about = {**versions(BENCHMARK_VERSION), **described(order.perturb)}
    with only_writer(order.out):
        known = _known(order.out, about)
        listed = [
            _look(order, split, task, about)
            for split in order.splits
            for task in order.tasks
        ]
        there = {name: e for name, e in known.items() if (order.out / name).exists()}
        for name in sorted(there):
            check_sum(order.out / name, there[name], "lemma generate")
        begin(order.out, RECORD, about)
        # Drop growing files from the manifest: a run killed between writing a file and
        # the manifest would otherwise make the file look damaged.
        grows = {file.path for file in listed if file.there < len(file.parts)}
        kept = {name: e for name, e in there.items() if order.out / name not in grows}
        if kept != known:
            write_json(order.out / MANIFEST, {"versions": about, "files": kept})
        made, worker_mb = _work(listed, engine, about, advance)
        rmtree(order.out / PARTS, ignore_errors=True)
        _write_manifest(order.out, about)
        name = "perturbed" if order.perturb else "recipe"
        more = "\n".join(describe(perturbed=True).splitlines()[2:])
        text = card(name, columns=describe(), more=more, **about)
        write_text(order.out / CARD, text)
    size = sum(file.path.stat().st_size for file in listed)
    seconds = perf_counter() - start
    return GenerateSummary(order.total, made, seconds, size / 1e6, worker_mb)


def _work(
    listed: list[_File],
    engine: Engine,
    about: dict[str, str],
    advance: Callable[[int], None],
) -> tuple[int, float]:
    """Make missing episodes, and merge files when their parts are complete.

    Returns:
        The number of new episodes, and the peak memory of a worker [MB].
    """
    parts = []
    left: Counter[tuple[str, str]] = Counter()
    by_name = {(file.task, file.split): file for file in listed}
    for name, file in by_name.items():
        for index, path in enumerate(file.parts):
            is_done = index < file.there or path.exists()
            left[name] += not is_done
            # Absolute paths, since workers of a cluster have another working folder.
            parts.append(Part((*name, index, path.absolute(), about), 1, is_done))
        if not left[name]:
            _put_together(file, about)
    worker_mb, failures = 0.0, []
    for part, (failure, used_mb) in do_missing(parts, generate_part, engine, advance):
        worker_mb = max(worker_mb, used_mb)
        if failure is not None:
            failures.append(failure)
            continue
        name = part.arguments[:2]
        left[name] -= 1
        if not left[name]:
            _put_together(by_name[name], about)
        advance(1)
    if failures:
        raise DatasetError(
            f"{len(failures)} episodes could not be made: "
            f"{'; '.join(sorted(failures)[:_SHOWN])}. The version that froze the "
            "instances solves all of them; see 'lemma doctor'. The other episodes are "
            "kept."
        )
    return sum(not part.is_done for part in parts), worker_mb


def generate_part(
    task: str, split: str, index: int, path: Path, about: dict[str, str]
) -> tuple[str | None, float]:
    """Write one episode as a part, if the expert solves it or if it is perturbed.

    Returns:
        Key and failure of a failed episode, None if it was written; and the peak memory
        of this process [MB].

    Raises:
        DatasetError: The part cannot be written.
    """
    failure, perturbation = None, perturbation_of(about)
    try:
        instance = load_instance(task, split, index)
    except SamplingError as error:
        return f"{task}/{split}/{index}: {error}", peak_memory_mb()
    record: EpisodeRecord
    if perturbation is not None:
        record = record_perturbed(instance, perturbation)
    else:
        record = record_episode(instance)
        # Only frozen instances are known to be solvable by the expert.
        if not record.success and split != FREE_SPLIT:
            failure = f"{record.key} ({record.failure})"
    if failure is None:
        write_table(path, to_table([record]), about)
    return failure, peak_memory_mb()


def _look(order: GenerateConfig, split: str, task: str, about: dict[str, str]) -> _File:
    """Return the state of a file and its parts.

    Raises:
        DatasetError: The file is of another version, or has too many episodes.
    """
    path, there = recipe_file(order.out, split, task), 0
    parts, wanted = order.out / PARTS / f"{split}-{task}", order.count(task, split)
    if path.exists():
        file, found = open_table(path)
        check_same_job(path, found, about)
        there = file.metadata.num_rows
    if there > wanted:
        raise DatasetError(
            f"{path} has {there} episodes, more than the requested {wanted}. Choose a "
            "new folder, or delete this file."
        )
    paths = tuple(parts / f"{index:05d}.parquet" for index in range(wanted))
    return _File(task, split, path, paths, there)


def _known(folder: Path, about: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Return the entries of the manifest, if there is one.

    Raises:
        DatasetError: The folder contains something other than such a recipe.
    """
    begun = (folder / PARTS).exists() or any(folder.glob("*/*.parquet"))
    check_free(folder, begun=begun)
    if not (folder / MANIFEST).exists():
        return {}
    manifest = read_json(folder / MANIFEST)
    if form := manifest.get("form"):
        raise DatasetError(
            f"{folder} contains {form!r}, rendered from a recipe. Choose another "
            "folder."
        )
    files = listed_files(folder)
    check_same_job(folder, listed_versions(folder), about)
    return files


def _put_together(file: _File, about: dict[str, str]) -> None:
    if not (parts := file.parts[file.there :]):
        return
    if gone := [path for path in parts if not path.exists()]:
        raise DatasetError(
            f"{gone[0]} was written, but is missing here. All machines of a cluster "
            "need the same folder: choose one on a shared file system."
        )
    paths = [file.path, *parts] if file.there else parts
    write_table(file.path, pa.concat_tables(map(read_table, paths)), about)
    rmtree(parts[0].parent, ignore_errors=True)


def _write_manifest(folder: Path, about: dict[str, str]) -> None:
    files = {}
    for path in sorted(folder.glob("*/*.parquet")):
        digests = [shorten(r.digest()) for r in from_table(read_table(path))]
        files[path.relative_to(folder).as_posix()] = {
            "sha256": sha256_of(path),
            "content_sha256": content_digest(digests),
            "episodes": len(digests),
            "digests": digests,
        }
    write_json(folder / MANIFEST, {"versions": about, "files": files})
