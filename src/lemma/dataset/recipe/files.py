"""The Parquet files of a recipe, and loading of its episodes on demand.

Reading needs neither MuJoCo nor torch.
"""

import json
import os
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from shlex import quote
from subprocess import DEVNULL, SubprocessError, check_output
from typing import Any, overload

import pyarrow as pa
import pyarrow.parquet as pq

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import damaged, parse_json, write_whole
from lemma.core.version import VERSION
from lemma.dataset.recipe.schema import (
    FORMAT_VERSION,
    PERTURBED_SCHEMA,
    SCHEMA,
    EpisodeRecord,
    from_table,
)

METADATA_KEY = b"lemma"
_KEPT_GROUPS = 8
REVISION_VARIABLE = "LEMMA_REVISION"
"""Environment variable with the git revision, for a checkout without .git."""
ROW_GROUP = 20
"""Number of episodes per row group, which are read together."""
WRITTEN_BY = "lemma generate"
"""The command that writes recipes."""


def versions(benchmark: str) -> dict[str, str]:
    """Return the versions that determine the bits of a recipe.

    Args:
        benchmark: Version of the benchmark's instances.
    """
    return {
        "format": FORMAT_VERSION,
        "benchmark": benchmark,
        "lemma": VERSION,
        "mujoco": version("mujoco"),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "revision": _revision(),
    }


def _revision() -> str:
    """Return the git revision of the package's checkout.

    Returns:
        The revision; ``"release"`` for an installed package; ``"unknown"`` for sources
        without a git revision. A repository of another project that contains the
        environment with the installed package is ignored.
    """
    named = os.environ.get(REVISION_VARIABLE)
    if named:
        return named
    root = Path(__file__).parents[4]
    if not (root / "src/lemma").is_dir():
        return "release"
    if not (root / ".git").exists():
        return "unknown"
    try:
        return check_output(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--match="],
            cwd=root,
            stderr=DEVNULL,
            text=True,
        ).strip()
    except (OSError, SubprocessError):
        return "unknown"


def write_table(path: Path, table: pa.Table, about: dict[str, str]) -> None:
    """Write a table of a recipe to Parquet, with a record of versions and settings."""
    metadata = {METADATA_KEY: json.dumps(about, sort_keys=True).encode()}
    # Combine the chunks: their boundaries would change the bytes.
    table = table.replace_schema_metadata(metadata).combine_chunks()

    def write(draft: Path) -> None:
        pq.write_table(
            table,
            draft,
            compression="zstd",
            row_group_size=ROW_GROUP,
            write_page_checksum=True,
        )

    write_whole(path, write)


def open_table(path: Path) -> tuple[pq.ParquetFile, dict[str, str]]:
    """Open a Parquet file of a recipe.

    Returns:
        The file, and its record of versions and settings.

    Raises:
        DatasetError: The file is truncated, or not of this format.
    """
    with explained(path):
        file = pq.ParquetFile(path, page_checksum_verification=True)
    found = (file.schema_arrow.metadata or {}).get(METADATA_KEY)
    known = (SCHEMA.names, PERTURBED_SCHEMA.names)
    if found is None or file.schema_arrow.names not in known:
        raise DatasetError(
            f"{path} is not a recipe of this benchmark. 'lemma generate' writes "
            "recipes."
        )
    about: dict[str, str] = parse_json(found, path)
    if about.get("format") != FORMAT_VERSION:
        raise DatasetError(
            f"{path} has format {about.get('format')}, but this version of the package "
            f"reads format {FORMAT_VERSION}. Install the version that wrote it "
            f"({about.get('lemma')}), or generate it again."
        )
    return file, about


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a Parquet file of a recipe.

    Args:
        path: The file.
        columns: Names of columns; all if None.

    Raises:
        DatasetError: The file is damaged, or not of this format.
    """
    with explained(path):
        return open_table(path)[0].read(columns=columns)


def read_group(path: Path, group: int) -> list[EpisodeRecord]:
    """Read the episodes of one row group of a file.

    Raises:
        DatasetError: The file is damaged.
    """
    with explained(path):
        return from_table(open_table(path)[0].read_row_group(group))


@contextmanager
def explained(path: Path, written_by: str = WRITTEN_BY) -> Iterator[None]:
    """Turn an error of Arrow about a file into a message.

    Args:
        path: The file.
        written_by: The command that writes the file.

    Raises:
        DatasetError: The message.
    """
    try:
        yield
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error, written_by)) from error


@dataclass(frozen=True, slots=True)
class _Place:
    """Position of an episode in the files."""

    path: Path
    group: int
    """Row group of the file."""
    row: int
    """Row of that group."""
    file_row: int
    """Row of the file."""


class Recipe(Sequence[EpisodeRecord]):
    """The episodes of a recipe, in the order of its files, read on demand.

    It can be pickled for the workers of a data loader; cached episodes are left out.
    """

    def __init__(self, folder: Path, places: list[_Place]) -> None:
        """Create the sequence; use :func:`load` instead.

        Args:
            folder: The recipe.
            places: Positions of the episodes.
        """
        self.folder = folder
        self._places = places
        self._groups: OrderedDict[tuple[Path, int], list[EpisodeRecord]] = OrderedDict()

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> EpisodeRecord: ...

    @overload
    def __getitem__(self, index: slice) -> "Recipe": ...

    def __getitem__(self, index: int | slice) -> "EpisodeRecord | Recipe":
        """Return an episode, or a part of the recipe.

        Raises:
            IndexError: There are fewer episodes.
            DatasetError: A file is damaged.
        """
        if isinstance(index, slice):
            return Recipe(self.folder, self._places[index])
        place = self._places[index]
        key = (place.path, place.group)
        if key not in self._groups:
            self._groups[key] = read_group(*key)
            if len(self._groups) > _KEPT_GROUPS:
                self._groups.popitem(last=False)
        self._groups.move_to_end(key)
        return self._groups[key][place.row]

    def __reduce__(self) -> tuple[type["Recipe"], tuple[Path, list[_Place]]]:
        """Return the state for pickling, without cached episodes."""
        return Recipe, (self.folder, self._places)

    def files(self) -> list[Path]:
        """Return the files of the episodes."""
        return list(dict.fromkeys(place.path for place in self._places))

    def groups(self) -> list[tuple[Path, int, tuple[int, ...]]]:
        """Return the row groups of the episodes: file, number, rows in the group."""
        rows: dict[tuple[Path, int], list[int]] = {}
        for place in self._places:
            rows.setdefault((place.path, place.group), []).append(place.row)
        return [(*key, tuple(found)) for key, found in rows.items()]

    def rows(self, *columns: str) -> Iterator[dict[str, Any]]:
        """Yield some columns of every episode, without reading the others.

        Args:
            *columns: Names of columns, see :data:`lemma.dataset.recipe.schema.SCHEMA`.
        """
        path, rows = None, []
        for place in self._places:
            if place.path != path:
                path = place.path
                rows = read_table(path, list(columns)).to_pylist()
            yield rows[place.file_row]

    def select(self, *, task: str | None = None, split: str | None = None) -> "Recipe":
        """Return the episodes of a task, of a split, or of both."""
        kept = [
            place
            for place in self._places
            if task in (None, place.path.stem)
            and split in (None, place.path.parent.name)
        ]
        return Recipe(self.folder, kept)

    def find(self, task: str, split: str, index: int) -> EpisodeRecord:
        """Return one episode by name.

        Raises:
            InvalidConfigError: The recipe has no such episode.
        """
        chosen = self.select(task=task, split=split)
        for place, row in enumerate(chosen.rows("index")):
            if row["index"] == index:
                return chosen[place]
        raise InvalidConfigError(
            f"{self.folder} has no episode {task}/{split}/{index}. 'lemma inspect "
            f"{quote(str(self.folder))}' lists its content."
        )


def load(folder: str | Path) -> Recipe:
    """Open a recipe.

    Args:
        folder: The folder that ``lemma generate`` wrote.

    Raises:
        DatasetError: There is no recipe, or a file is damaged or of another format.
    """
    folder = Path(folder)
    paths = sorted(folder.glob("*/*.parquet"))
    if not paths:
        raise DatasetError(
            f"There is no recipe in {folder}. Write one with 'lemma generate --out "
            f"{quote(str(folder))}'."
        )
    places = []
    for path in paths:
        file, _ = open_table(path)
        count = 0
        for group in range(file.num_row_groups):
            rows = file.metadata.row_group(group).num_rows
            places += [_Place(path, group, row, count + row) for row in range(rows)]
            count += rows
    return Recipe(folder, places)
