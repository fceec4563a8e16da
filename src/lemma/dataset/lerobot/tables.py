"""The tables of a LeRobotDataset: frames, episodes, sentences."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lemma.dataset.files import write_whole
from lemma.dataset.lerobot.episode import FRAMES, LOCAL_SUBTASK, Note, read_note
from lemma.dataset.lerobot.layout import (
    EPISODES_PER_FILE,
    Style,
    chunk_and_file,
    episodes_path,
    features,
    instruction_key,
    video_keys,
)
from lemma.dataset.lerobot.stats import FIGURES, Stats, Total, describe
from lemma.tasks.language.template import KINDS

_ARROW = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
_ROWS = 100


class Sentences:
    """Different sentences, numbered in the order in which they came up."""

    def __init__(self) -> None:
        """Begin with none."""
        self._numbers: dict[str, int] = {}

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._numbers)

    def number(self, sentence: str) -> int:
        """Return the number of a sentence, which is taken up if it is new."""
        return self._numbers.setdefault(sentence, len(self._numbers))

    def write(self, path: Path, column: str, index: str) -> None:
        """Write them as a table that pandas reads with the sentences as its index.

        Args:
            path: The Parquet file.
            column: Name of the column of numbers.
            index: Name of the index.
        """
        numbers = pa.array(self._numbers.values(), pa.int64())
        table = pa.table({column: numbers, index: pa.array(self._numbers, pa.string())})
        told = {
            "index_columns": [index],
            "column_indexes": [],
            "columns": [
                _pandas_column(column, "int64", "int64"),
                _pandas_column(index, "unicode", "object"),
            ],
        }
        table = table.replace_schema_metadata({"pandas": json.dumps(told)})
        write_whole(path, partial(pq.write_table, table))


def _pandas_column(name: str, pandas_type: str, numpy_type: str) -> dict[str, Any]:
    return {
        "name": name,
        "field_name": name,
        "pandas_type": pandas_type,
        "numpy_type": numpy_type,
        "metadata": None,
    }


@dataclass(frozen=True, slots=True)
class Placement:
    """Where an episode is in the data set."""

    part: Path
    """The part that it comes from."""
    number: int
    """Number of the episode."""
    start: int
    """Number of its first frame."""
    length: int
    """Frames."""
    data_file: int
    """Number of the file of its frames."""
    video_files: dict[str, tuple[int, int]]
    """Of each video by key: number of the file, and the episode's first frame there."""


class Writer:
    """Writes the tables."""

    def __init__(
        self,
        robots: tuple[str, ...],
        style: Style,
        tasks: Sentences,
        subtasks: Sentences,
    ) -> None:
        """Keep what all tables need.

        Args:
            robots: Names of the robots.
            style: How they were filmed.
            tasks: All instructions.
            subtasks: All sub-tasks in words.
        """
        self._style = style
        self._tasks = tasks
        self._subtasks = subtasks
        self._features = features(robots, style)
        self._robots = robots
        self._schema = _episode_schema(robots, style, self._features)

    def write_frames(self, path: Path, placements: Sequence[Placement]) -> None:
        """Write the frames of some episodes, one row group for each.

        Args:
            path: The Parquet file.
            placements: The episodes.
        """
        schema = pa.schema(
            {
                name: _arrow(feature)
                for name, feature in self._features.items()
                if feature["dtype"] != "video"
            }
        )

        def write(draft: Path) -> None:
            with pq.ParquetWriter(draft, schema, compression="zstd") as writer:
                for placement in placements:
                    writer.write_table(self._frames(placement).select(schema.names))

        write_whole(path, write)

    def _frames(self, placement: Placement) -> pa.Table:
        table = pq.read_table(placement.part / FRAMES)
        numbers = self._numbers(placement, read_note(placement.part), table)
        for name, values in numbers.items():
            table = table.append_column(name, pa.array(values, pa.int64()))
        return table

    def _numbers(
        self, placement: Placement, note: Note, table: pa.Table
    ) -> dict[str, Any]:
        """Return the columns that say where a frame belongs."""
        words = [self._subtasks.number(sentence) for sentence in note.subtasks]
        local = table[LOCAL_SUBTASK].to_numpy()
        return {
            **self._constants(placement, note),
            "index": np.arange(placement.start, placement.start + placement.length),
            "subtask_index": np.array(words)[local],
        }

    def _constants(self, placement: Placement, note: Note) -> dict[str, Any]:
        tasks = {kind: self._tasks.number(note.instructions[kind]) for kind in KINDS}
        found = {
            "episode_index": placement.number,
            "task_index": tasks[self._style.instruction],
            **{instruction_key(kind): tasks[kind] for kind in KINDS},
        }
        return {name: np.full(placement.length, n) for name, n in found.items()}

    def write_episodes(self, folder: Path, placements: Sequence[Placement]) -> None:
        """Write what is known of every episode.

        Args:
            folder: The data set.
            placements: The episodes, all of them.
        """
        for first in range(0, len(placements), EPISODES_PER_FILE):
            number = first // EPISODES_PER_FILE
            rows = placements[first : first + EPISODES_PER_FILE]
            path = folder / episodes_path(number)
            write_whole(path, partial(self._episodes, number, rows))

    def _episodes(
        self, number: int, placements: Sequence[Placement], draft: Path
    ) -> None:
        with pq.ParquetWriter(draft, self._schema, compression="zstd") as writer:
            for first in range(0, len(placements), _ROWS):
                some = placements[first : first + _ROWS]
                rows = [self._episode(number, placement) for placement in some]
                table = pa.Table.from_pylist(rows, schema=self._schema)
                writer.write_table(table)

    def _episode(self, number: int, placement: Placement) -> dict[str, Any]:
        note = read_note(placement.part)
        chunk, file = chunk_and_file(placement.data_file)
        row: dict[str, Any] = {
            "episode_index": placement.number,
            "tasks": [note.instructions[self._style.instruction]],
            "length": placement.length,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": placement.start,
            "dataset_to_index": placement.start + placement.length,
        }
        for key, (video, begin) in placement.video_files.items():
            chunk, file = chunk_and_file(video)
            row[f"videos/{key}/chunk_index"] = chunk
            row[f"videos/{key}/file_index"] = file
            row[f"videos/{key}/from_timestamp"] = begin / self._style.fps
            end = (begin + placement.length) / self._style.fps
            row[f"videos/{key}/to_timestamp"] = end
        for key, figures in self.stats(placement, note).items():
            row |= {f"stats/{key}/{name}": value for name, value in figures.items()}
        for name in ("key", "task", "split", "index", "team", "distractors", "success"):
            row[f"lemma/{name}"] = getattr(note, name)
        row |= {f"lemma/{kind}": note.instructions[kind] for kind in KINDS}
        row["lemma/subtasks"] = note.subtasks[:-1]
        for robot, camera in note.cameras.items():
            row |= {f"camera/{robot}/{name}": value for name, value in camera.items()}
        chunk, file = chunk_and_file(number)
        row["meta/episodes/chunk_index"] = chunk
        row["meta/episodes/file_index"] = file
        return row

    def stats(self, placement: Placement, note: Note) -> dict[str, Stats]:
        """Return the figures of every feature of an episode.

        Args:
            placement: The episode.
            note: What its part says.
        """
        table = pq.read_table(placement.part / FRAMES, columns=[LOCAL_SUBTASK])
        numbers = self._numbers(placement, note, table)
        found = {name: describe(values) for name, values in numbers.items()}
        return {name: {**note.stats, **found}[name] for name in self._features}

    def total_stats(self, placements: Iterable[Placement]) -> dict[str, Stats]:
        """Return the figures of every feature over all episodes.

        Args:
            placements: The episodes.
        """
        totals = {name: Total() for name in self._features}
        for placement in placements:
            stats = self.stats(placement, read_note(placement.part))
            for name, figures in stats.items():
                totals[name].add(figures)
        return {name: total.figures() for name, total in totals.items()}


def _arrow(feature: dict[str, Any]) -> pa.DataType:
    kind, size = _ARROW[feature["dtype"]], feature["shape"][0]
    return kind if size == 1 else pa.list_(kind, size)


def _episode_schema(
    robots: tuple[str, ...], style: Style, listed: dict[str, dict[str, Any]]
) -> pa.Schema:
    whole, real, text = pa.int64(), pa.float64(), pa.string()
    fields = {
        "episode_index": whole,
        "tasks": pa.list_(text),
        "length": whole,
        "data/chunk_index": whole,
        "data/file_index": whole,
        "dataset_from_index": whole,
        "dataset_to_index": whole,
    }
    for key in video_keys(robots, style):
        fields[f"videos/{key}/chunk_index"] = whole
        fields[f"videos/{key}/file_index"] = whole
        fields[f"videos/{key}/from_timestamp"] = real
        fields[f"videos/{key}/to_timestamp"] = real
    for key, feature in listed.items():
        one = pa.list_(real)
        figure = pa.list_(pa.list_(one)) if feature["dtype"] == "video" else one
        for name in FIGURES:
            count = name == "count"
            fields[f"stats/{key}/{name}"] = pa.list_(whole) if count else figure
    fields |= {f"lemma/{name}": text for name in ("key", "task", "split")}
    fields |= {"lemma/index": whole, "lemma/team": text, "lemma/distractors": whole}
    fields["lemma/success"] = pa.bool_()
    fields |= {f"lemma/{kind}": text for kind in KINDS}
    fields["lemma/subtasks"] = pa.list_(text)
    for robot in robots:
        fields[f"camera/{robot}/intrinsics"] = pa.list_(real)
        fields[f"camera/{robot}/world_from_camera"] = pa.list_(real)
    fields["meta/episodes/chunk_index"] = whole
    fields["meta/episodes/file_index"] = whole
    return pa.schema(fields)
