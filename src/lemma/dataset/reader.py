"""Read a recipe: episodes on demand, with neither MuJoCo nor torch."""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.dataset.files import open_table
from lemma.dataset.schema import EpisodeRecord, from_table

_KEPT_GROUPS = 8
_HEADER = ("key", "task", "split", "index", "team", "distractors")


@dataclass(frozen=True, slots=True)
class EpisodeHeader:
    """What is known of an episode before it is read."""

    key: str
    task: str
    split: str
    index: int
    team: str
    distractors: int


class Recipe(Sequence[EpisodeRecord]):
    """The episodes of a recipe, in the order of its files; read when asked for."""

    def __init__(self, folder: Path, places: list[tuple[Path, int]]) -> None:
        """Keep where the episodes are; use :func:`load` instead.

        Args:
            folder: The recipe.
            places: File and row of every episode.
        """
        self.folder = folder
        self._places = places
        self._groups: OrderedDict[tuple[Path, int], list[EpisodeRecord]] = OrderedDict()
        self._headers: dict[Path, list[EpisodeHeader]] = {}

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self._places)

    def __getitem__(self, index: int) -> EpisodeRecord:  # type: ignore[override]
        """Return an episode.

        Raises:
            IndexError: There are not so many.
        """
        path, row = self._places[index]
        file, _ = open_table(path)
        group = 0
        while row >= file.metadata.row_group(group).num_rows:
            row -= file.metadata.row_group(group).num_rows
            group += 1
        return self._group(path, group, file)[row]

    def _group(
        self, path: Path, group: int, file: pq.ParquetFile
    ) -> list[EpisodeRecord]:
        key = (path, group)
        if key not in self._groups:
            try:
                self._groups[key] = from_table(file.read_row_group(group))
            except (OSError, pa.ArrowException) as error:
                raise DatasetError(
                    f"{path} is damaged: {error}. Delete it and run 'lemma generate' "
                    "again: it writes what is missing."
                ) from error
            if len(self._groups) > _KEPT_GROUPS:
                self._groups.popitem(last=False)
        self._groups.move_to_end(key)
        return self._groups[key]

    def headers(self) -> Iterator[EpisodeHeader]:
        """Yield what is known of every episode, without reading its states."""
        for path, row in self._places:
            if path not in self._headers:
                table = open_table(path)[0].read(columns=list(_HEADER))
                self._headers[path] = [EpisodeHeader(**r) for r in table.to_pylist()]
            yield self._headers[path][row]

    def select(self, *, task: str | None = None, split: str | None = None) -> "Recipe":
        """Return the episodes of a task, of a split, or of both."""
        kept = [
            place
            for place in self._places
            if task in (None, place[0].stem) and split in (None, place[0].parent.name)
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
            f"{self.folder}' says what it has."
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
            f"{folder}'."
        )
    places = []
    for path in paths:
        file, _ = open_table(path)
        places += [(path, row) for row in range(file.metadata.num_rows)]
    return Recipe(folder, places)
