"""Read a recipe: episodes on demand, with neither MuJoCo nor torch."""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any, overload

import pyarrow as pa

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import damaged
from lemma.dataset.recipe.files import WRITTEN_BY, open_table, read_table
from lemma.dataset.recipe.schema import EpisodeRecord, from_table

_KEPT_GROUPS = 8
_HEADER = ("key", "task", "split", "index", "team", "distractors")


@dataclass(frozen=True, slots=True)
class EpisodeHeader:
    """The columns that name an episode."""

    key: str
    task: str
    split: str
    index: int
    team: str
    distractors: int


@dataclass(frozen=True, slots=True)
class _Place:
    """Where an episode is."""

    path: Path
    group: int
    """Row group of the file."""
    row: int
    """Row of that group."""
    file_row: int
    """Row of the file."""


class Recipe(Sequence[EpisodeRecord]):
    """The episodes of a recipe, in the order of its files; read when asked for.

    It can be sent to the workers of a data loader, without the episodes read so far.
    """

    def __init__(self, folder: Path, places: list[_Place]) -> None:
        """Keep where the episodes are; use :func:`load` instead.

        Args:
            folder: The recipe.
            places: Where every episode is.
        """
        self.folder = folder
        self._places = places
        self._groups: OrderedDict[tuple[Path, int], list[EpisodeRecord]] = OrderedDict()
        self._headers: dict[Path, list[EpisodeHeader]] = {}

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
            IndexError: There are not so many.
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
        """Leave out what was read."""
        return Recipe, (self.folder, self._places)

    def files(self) -> list[Path]:
        """Return the files that the episodes are in."""
        return list(dict.fromkeys(place.path for place in self._places))

    def groups(self) -> list[tuple[Path, int, tuple[int, ...]]]:
        """Return the row groups that the episodes are in: file, number, rows of it."""
        rows: dict[tuple[Path, int], list[int]] = {}
        for place in self._places:
            rows.setdefault((place.path, place.group), []).append(place.row)
        return [(*key, tuple(found)) for key, found in rows.items()]

    def headers(self) -> Iterator[EpisodeHeader]:
        """Yield the header of every episode, without reading its states."""
        for place in self._places:
            if place.path not in self._headers:
                table = read_table(place.path, list(_HEADER))
                rows = [EpisodeHeader(**row) for row in table.to_pylist()]
                self._headers[place.path] = rows
            yield self._headers[place.path][place.file_row]

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
            InvalidConfigError: It is not in this recipe.
        """
        chosen = self.select(task=task, split=split)
        for place, header in enumerate(chosen.headers()):
            if header.index == index:
                return chosen[place]
        raise InvalidConfigError(
            f"{self.folder} has no episode {task}/{split}/{index}. 'lemma inspect "
            f"{quote(str(self.folder))}' says what it has."
        )


def load(folder: str | Path) -> Recipe:
    """Open a recipe.

    Args:
        folder: Where ``lemma generate`` wrote it.

    Raises:
        DatasetError: There is none, or a file is damaged or of another format.
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


def read_group(path: Path, group: int) -> list[EpisodeRecord]:
    """Read the episodes of one row group of a file.

    Raises:
        DatasetError: It is damaged.
    """
    file, _ = open_table(path)
    try:
        return from_table(file.read_row_group(group))
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error, WRITTEN_BY)) from error
