"""Rendered keyframes for training: a map-style data set, and one that is in memory.

Both give NumPy arrays; ``torch.utils.data.DataLoader`` takes them as they are. Neither
MuJoCo nor torch is needed.
"""

import json
import threading
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from os import getpid
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lemma.core.errors import UnknownNameError
from lemma.dataset.instructions import (
    RECORDED,
    Language,
    check_recorded,
    draw_instruction,
)
from lemma.dataset.rendered.keyframes.files import KeyframeFile, mapped
from lemma.dataset.rendered.keyframes.schema import (
    Header,
    camera_columns,
    map_columns,
)
from lemma.dataset.rendered.shards import keyframe_shards

Sample = dict[str, Any]
"""One keyframe: values by the names of columns; tensors as NumPy arrays."""
Indices = Sequence[int] | NDArray[np.integer[Any]]

LABELS = (
    *("key", "task", "index", "keyframe", "keyframes"),
    *("robot", "primitive", "pick", "place", "pick_pose", "place_pose"),
)
"""Labels of a policy's decision."""
POLICY_COLUMNS = (*LABELS, "arms", "bases", "joints", "opening_m", "sub_instruction")
"""Columns that a policy needs beside its images and the instruction."""
MAP_COLUMNS = ("map_rgb", "map_height")
CAMERA_COLUMNS = ("intrinsics", "world_from_camera", "rgb", "depth")

_OPEN_FILES = 600
"""Files open at a time: each takes a descriptor, and systems allow 1024."""


class KeyframeDataset:
    """Keyframes of a split: ``len(dataset)`` and ``dataset[i]``, nothing else to do.

    Samples are dictionaries of the columns asked for, ``instruction``, and, with the
    map's height, ``map_coverage``: whether a camera sees the cell. Files are opened
    when they are first needed, in each thread for itself.
    """

    def __init__(
        self,
        folder: str | Path,
        split: str = "train",
        tasks: Sequence[str] = (),
        columns: Sequence[str] = (*MAP_COLUMNS, *POLICY_COLUMNS),
        language: Language = RECORDED,
    ) -> None:
        """Open the data set; no keyframe is read.

        Args:
            folder: Written by ``lemma render --form keyframes``.
            split: Name of a split.
            tasks: Names of tasks; all if empty.
            columns: Contents of a sample; see ``docs/rendered_format.md``.
            language: Source of the instructions.

        Raises:
            DatasetError: Files are missing, cut short, or of another version.
            UnknownNameError: There is no such split, task or column.
        """
        if language.instructions == "recorded":
            check_recorded(language.kind, (split,))
        self.folder = Path(folder)
        self.language = language
        self.epoch = 0
        self._drawn: dict[str, str] = {}
        self.shards = keyframe_shards(self.folder, split, tasks)
        self.raster = self.shards[0].header.raster
        self._ends = list(accumulate(sum(s.header.keyframes) for s in self.shards))
        self._columns = _by_part(columns, language, self.shards[0].header)
        self._added = set().union(*self._columns.values()) - set(columns)
        self._local = threading.local()
        self._sources: dict[tuple[int, int, str], pa.NativeFile] = {}

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return self._ends[-1]

    def __getitem__(self, index: int | Indices) -> Sample:
        """Return a keyframe; for several indices, :meth:`batch` of them.

        Raises:
            IndexError: There are not so many.
            DatasetError: Its file is damaged.
        """
        if not isinstance(index, int | np.integer):
            return self.batch(index)
        index = range(len(self))[int(index)]
        shard = bisect_right(self._ends, index)
        row = index - (self._ends[shard - 1] if shard else 0)
        sample: Sample = {}
        for part, columns in self._columns.items():
            if columns:
                sample.update(self._open(shard, part, columns)[row])
        sample["instruction"] = self._instruction(sample)
        if "map_height" in sample:
            sample["map_coverage"] = sample["map_height"] > 0
        for name in self._added:
            del sample[name]
        return sample

    def set_epoch(self, epoch: int) -> None:
        """Draw other sentences from now on, where they are resampled.

        Workers of a data loader have copies of this object: call it before they start.
        Persistent workers never learn of it.
        """
        self.epoch = epoch
        self._drawn = {}

    def batch(self, indices: Indices, out: Sample | None = None) -> Sample:
        """Return keyframes stacked: arrays with one row for each, lists of texts.

        Faster than stacking samples, which by then have left the processor's cache.
        ``DataLoader(dataset, batch_size=None, sampler=BatchSampler(...))`` asks for
        batches in this way.

        Args:
            indices: Which keyframes; at least one.
            out: A batch of the same size whose arrays are used again: much of the time
                goes into new memory.
        """
        stacked: Sample = {}
        for row, index in enumerate(indices):
            for name, value in self[int(index)].items():
                if isinstance(value, str):
                    stacked.setdefault(name, []).append(value)
                    continue
                if row == 0:
                    array = np.asarray(value)
                    shape = (len(indices), *array.shape)
                    stacked[name] = out[name] if out else np.empty(shape, array.dtype)
                stacked[name][row] = value
        return stacked

    def episodes(self) -> list[range]:
        """Return the indices of every episode's keyframes, in order."""
        counts = [count for shard in self.shards for count in shard.header.keyframes]
        ends = list(accumulate(counts))
        return [range(end - n, end) for end, n in zip(ends, counts, strict=True)]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out open files, which belong to a thread, and drawn sentences."""
        return {**self.__dict__, "_local": None, "_sources": {}, "_drawn": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Begin with nothing open."""
        self.__dict__.update(state)
        self._local = threading.local()

    def _open(self, shard: int, part: str, columns: tuple[str, ...]) -> KeyframeFile:
        """Return an open file of this thread of this process."""
        mine = self._local.__dict__
        if mine.get("process") != getpid():
            mine["process"], mine["files"] = getpid(), {}
        files: dict[tuple[int, str], KeyframeFile] = mine["files"]
        file = files.get((shard, part))
        if file is None:
            if len(files) >= _OPEN_FILES:
                del files[next(iter(files))]
            path = self.shards[shard].paths[part]
            file = KeyframeFile(path, columns, self._source(shard, part))
            files[shard, part] = file
        return file

    def _source(self, shard: int, part: str) -> pa.NativeFile:
        """Return a file that all threads of this process share."""
        place = getpid(), shard, part
        source = self._sources.get(place)
        if source is None:
            too_many = len(self._sources) + 1 - _OPEN_FILES
            for old in list(self._sources)[: max(0, too_many)]:
                self._sources.pop(old, None)
            path = self.shards[shard].paths[part]
            source = self._sources.setdefault(place, mapped(path))
        return source

    def _instruction(self, sample: Sample) -> str:
        if self.language.instructions == "recorded":
            recorded: str = sample[self.language.kind]
            return recorded
        key: str = sample["key"]
        if key not in self._drawn:
            self._drawn[key] = draw_instruction(
                sample["task"],
                tuple((top, bottom) for top, bottom in json.loads(sample["goal"])),
                key,
                seed=self.language.seed,
                epoch=self.epoch,
            )
        return self._drawn[key]


def _by_part(
    columns: Sequence[str], language: Language, header: Header
) -> dict[str, tuple[str, ...]]:
    """Return which columns to read from which part.

    Raises:
        UnknownNameError: There is no such column.
    """
    maps, cameras = map_columns(header), camera_columns(header)
    for name in columns:
        if name not in maps and name not in cameras:
            raise UnknownNameError("column", name, [*maps, *cameras])
    needed = (
        (language.kind,)
        if language.instructions == "recorded"
        else ("key", "task", "goal")
    )
    wanted = dict.fromkeys((*columns, *needed))
    return {
        "maps": tuple(name for name in wanted if name in maps),
        "cameras": tuple(name for name in wanted if name not in maps),
    }
