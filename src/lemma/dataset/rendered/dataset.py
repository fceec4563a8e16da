"""Rendered keyframes for training: a map-style data set, and one in memory.

Both return NumPy arrays and work with ``torch.utils.data.DataLoader``. They need
neither MuJoCo nor torch.
"""

import glob
import json
import os
import threading
from bisect import bisect_right
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from filelock import FileLock
from numpy.typing import NDArray

from lemma.core.arguments import known
from lemma.core.errors import DatasetError, UnknownNameError
from lemma.core.files import write_whole
from lemma.dataset.files import MANIFEST, listed_files, read_manifest
from lemma.dataset.instructions import (
    RECORDED,
    Language,
    check_recorded,
    draw_instruction,
)
from lemma.dataset.rendered.keyframes import (
    FORM,
    PARTS,
    Header,
    KeyframeFile,
    camera_columns,
    map_columns,
    mapped,
)
from lemma.scene.raster import Raster

Sample = dict[str, Any]
"""One keyframe: values by the names of columns; tensors as NumPy arrays."""
Indices = Sequence[int] | NDArray[np.integer[Any]]

LABELS = (
    *("key", "task", "index", "keyframe", "keyframes"),
    *("robot", "primitive", "pick", "place", "pick_pose", "place_pose"),
)
"""Labels of a policy's decision."""
POLICY_COLUMNS = (*LABELS, "arms", "bases", "joints", "opening_m", "sub_instruction")
"""Columns that a policy needs besides its images and the instruction."""
MAP_COLUMNS = ("map_rgb", "map_height")
CAMERA_COLUMNS = ("intrinsics", "world_from_camera", "rgb", "depth")

_OPEN_FILES = 600
"""Largest number of open files; systems often allow 1024 descriptors."""
SHARED = ".maps"
"""Folder in a data set with the maps that processes share."""
_THREADS = 16


@dataclass(frozen=True, slots=True)
class Shard:
    """Files of all parts with the same keyframes."""

    task: str
    split: str
    paths: dict[str, Path]
    """Files by part."""
    header: Header
    """Header of the file with maps."""


def keyframe_shards(folder: Path, split: str, tasks: Sequence[str] = ()) -> list[Shard]:
    """Return the files of a split of rendered keyframes.

    Args:
        folder: Output folder of ``lemma render --form keyframes``.
        split: Name of a split.
        tasks: Names of tasks; all if empty.

    Raises:
        DatasetError: Files are missing, truncated, or of another version.
        UnknownNameError: There is no such split or task.
    """
    files = read_manifest(folder, FORM)
    for name, entry in files.items():
        _check_size(folder / name, entry)
    # Paths are like maps/train/stack-003.arrow.
    paths = [path for path in map(Path, files) if path.parts[0] == PARTS[0]]
    known("split in this data set", split, sorted({p.parent.name for p in paths}))
    found = [(p.stem.rpartition("-")[0], p) for p in paths if p.parent.name == split]
    for task in tasks:
        known(f"task of split {split!r}", task, sorted({name for name, _ in found}))
    shards = []
    for task, path in found:
        if task in (tasks or (task,)):
            places = {part: folder / part / split / path.name for part in PARTS}
            header = KeyframeFile(places[PARTS[0]]).header
            shards.append(Shard(task, split, places, header))
    return shards


def _check_size(path: Path, entry: dict[str, Any]) -> None:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise DatasetError(
            f"{path} is missing. Run 'lemma render' again, which makes missing files."
        ) from error
    if size != entry.get("bytes"):
        raise DatasetError(
            f"{path} has {size} bytes, but {entry.get('bytes')} in {MANIFEST}: it was "
            "truncated or changed. Delete it and run 'lemma render' again."
        )


class KeyframeDataset:
    """Map-style data set of the keyframes of a split.

    A sample is a dictionary with the chosen columns and ``instruction``. With the map's
    height it also has ``map_coverage``: whether a camera sees each cell. Each thread
    opens files when it first needs them.
    """

    def __init__(
        self,
        folder: str | Path,
        split: str = "train",
        tasks: Sequence[str] = (),
        columns: Sequence[str] = (*MAP_COLUMNS, *POLICY_COLUMNS),
        language: Language = RECORDED,
    ) -> None:
        """Open the data set without reading keyframes.

        Args:
            folder: Output folder of ``lemma render --form keyframes``.
            split: Name of a split.
            tasks: Names of tasks; all if empty.
            columns: Columns of a sample; see ``docs/rendered_format.md``.
            language: Source of the instructions.

        Raises:
            DatasetError: Files are missing, truncated, or of another version.
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
        """Return a keyframe; for several indices, their :meth:`batch`.

        Raises:
            IndexError: There are fewer keyframes.
            DatasetError: A file is damaged.
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
        """Draw new sentences from now on, if they are resampled.

        Workers of a data loader have copies of this object, so call this before they
        start. It has no effect on persistent workers.

        Args:
            epoch: Number of the epoch.
        """
        self.epoch = epoch
        self._drawn = {}

    def batch(self, indices: Indices, out: Sample | None = None) -> Sample:
        """Return stacked keyframes: arrays (n, ...) and lists of n texts.

        This is faster than stacking samples, which are no longer in the processor's
        cache. ``DataLoader(dataset, batch_size=None, sampler=BatchSampler(...))`` gets
        batches in this way.

        Args:
            indices: Indices of one or more keyframes.
            out: A batch of the same size whose arrays are reused, which saves the time
                for allocation.
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
        """Return the range of keyframe indices of every episode, in order."""
        counts = [count for shard in self.shards for count in shard.header.keyframes]
        ends = list(accumulate(counts))
        return [range(end - n, end) for end, n in zip(ends, counts, strict=True)]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling, without open files and drawn sentences."""
        return {**self.__dict__, "_local": None, "_sources": {}, "_drawn": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state, without open files."""
        self.__dict__.update(state)
        self._local = threading.local()

    def _open(self, shard: int, part: str, columns: tuple[str, ...]) -> KeyframeFile:
        """Return an open file of the present thread and process."""
        mine = self._local.__dict__
        if mine.get("process") != os.getpid():
            mine["process"], mine["files"] = os.getpid(), {}
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
        place = os.getpid(), shard, part
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
    """Return the columns to read, by part.

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


@dataclass(frozen=True)
class MapsInMemory:
    """The maps and labels of all keyframes of a split in memory, for fast training.

    A keyframe takes 0.9 MB with maps of the usual size.
    """

    rgb: NDArray[np.uint8]
    """Colors of the maps, shape (N, rows, columns, 3)."""
    height: NDArray[np.uint16]
    """Stored heights: 1 + height above ``raster.floor_m`` [0.1 mm], 0 where no camera
    sees; shape (N, rows, columns)."""
    columns: dict[str, NDArray[Any]]
    """The other columns, each of length N; texts have dtype object."""
    raster: Raster

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self.rgb)

    @property
    def nbytes(self) -> int:
        """Size of all maps [bytes]."""
        return self.rgb.nbytes + self.height.nbytes

    @cached_property
    def coverage(self) -> NDArray[np.bool_]:
        """Whether a camera sees each cell, shape (N, rows, columns); computed once."""
        return self.height > 0

    @classmethod
    def load(
        cls,
        folder: str | Path,
        split: str = "train",
        tasks: Sequence[str] = (),
        columns: Sequence[str] = POLICY_COLUMNS,
        language: Language = RECORDED,
        *,
        shared: bool = False,
    ) -> "MapsInMemory":
        """Read all keyframes of a split.

        Args:
            folder: Output folder of ``lemma render --form keyframes``.
            split: Name of a split.
            tasks: Names of tasks; all if empty.
            columns: Columns besides the maps.
            language: Source of the instructions.
            shared: Whether processes of this machine share the maps: the first writes
                them uncompressed into the folder ``.maps`` of the data set, and all
                memory-map these files. Maps of earlier content are deleted.

        Raises:
            DatasetError: Files are missing or damaged, or the maps cannot be written.
        """
        folder = Path(folder)
        if shared:
            labels = KeyframeDataset(folder, split, tasks, columns, language)
            rgb, height = _shared_maps(folder, split, tasks, labels.shards)
            rows = [labels[index] for index in range(len(labels))]
            return cls(rgb, height, _by_column(rows), labels.raster)
        dataset = KeyframeDataset(
            folder, split, tasks, (*MAP_COLUMNS, *columns), language
        )
        count, raster = len(dataset), dataset.raster
        rgb = np.empty((count, raster.rows, raster.columns, 3), np.uint8)
        height = np.empty((count, raster.rows, raster.columns), np.uint16)

        def read(index: int) -> Sample:
            sample = dataset[index]
            rgb[index], height[index] = sample.pop("map_rgb"), sample.pop("map_height")
            del sample["map_coverage"]
            return sample

        # Allocation and decompression take most of the time and release the GIL.
        with ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
            rows = list(pool.map(read, range(count)))
        return cls(rgb, height, _by_column(rows), raster)


def _shared_maps(
    folder: Path, split: str, tasks: Sequence[str], shards: Sequence[Shard]
) -> list[NDArray[Any]]:
    """Return memory-mapped colors and heights; the first process writes the files.

    Raises:
        DatasetError: The files cannot be written or read.
    """
    place = folder / SHARED
    stem = "-".join((split, *tasks))
    # Names depend on the content, since files of the data set may be replaced.
    files = listed_files(folder)
    names = (shard.paths["maps"].relative_to(folder).as_posix() for shard in shards)
    sums = "".join(files[name]["sha256"] for name in names)
    content = sha256(sums.encode()).hexdigest()[:16]
    paths = [place / f"{stem}.{content}.{name}.npy" for name in ("rgb", "height")]
    try:
        place.mkdir(exist_ok=True)
        with FileLock(place / f"{stem}.lock"):
            if not all(path.exists() for path in paths):
                for old in place.glob(f"{glob.escape(stem)}.*.npy"):
                    old.unlink()
                maps = MapsInMemory.load(folder, split, tasks, ())
                _save(paths[0], maps.rgb)
                _save(paths[1], maps.height)
            # Copy-on-write, since torch requires writable arrays.
            return [np.load(path, mmap_mode="c") for path in paths]
    except (OSError, ValueError) as error:
        raise DatasetError(
            f"The maps cannot be shared through {place}: {error}. Leave out "
            "--shared-images, or delete that folder."
        ) from error


def _save(path: Path, array: NDArray[Any]) -> None:
    def write(draft: Path) -> None:
        with draft.open("wb") as file:
            np.save(file, array)

    write_whole(path, write)


def _by_column(rows: Sequence[Sample]) -> dict[str, NDArray[Any]]:
    return {name: _stacked([row[name] for row in rows]) for name in rows[0]}


def _stacked(values: Sequence[Any]) -> NDArray[Any]:
    """Return values as one array; texts and arrays of different shapes as objects."""
    if not isinstance(values[0], str) and len({np.shape(v) for v in values}) == 1:
        return np.array(values)
    found = np.empty(len(values), object)
    found[:] = values
    return found
