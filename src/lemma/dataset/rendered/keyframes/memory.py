"""The maps of a split in memory, for the fastest training loop."""

import glob
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from numpy.typing import NDArray

from lemma.core.errors import DatasetError
from lemma.core.files import write_whole
from lemma.dataset.files import listed_files
from lemma.dataset.instructions import RECORDED, Language
from lemma.dataset.rendered.keyframes.dataset import (
    MAP_COLUMNS,
    POLICY_COLUMNS,
    KeyframeDataset,
    Sample,
)
from lemma.dataset.rendered.shards import Shard
from lemma.scene.raster import Raster

SHARED = ".maps"
"""Folder, in a data set, of maps that processes share."""
_THREADS = 16


@dataclass(frozen=True)
class MapsInMemory:
    """The maps of all keyframes of a split, with their labels, for the fastest loop.

    0.9 MB per keyframe with maps of the usual size.
    """

    rgb: NDArray[np.uint8]
    """Shape (N, rows, columns, 3)."""
    height: NDArray[np.uint16]
    """As stored: 1 + height above ``raster.floor_m`` [0.1 mm], 0 where no camera sees;
    shape (N, rows, columns)."""
    columns: dict[str, NDArray[Any]]
    """The other columns, each of length N; texts as objects."""
    raster: Raster

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self.rgb)

    @property
    def nbytes(self) -> int:
        """Bytes of all images."""
        return self.rgb.nbytes + self.height.nbytes

    @cached_property
    def coverage(self) -> NDArray[np.bool_]:
        """Where a camera sees, shape (N, rows, columns); computed once."""
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
        """Read everything; the arguments are those of :class:`KeyframeDataset`.

        Args:
            folder: The data set.
            split: Name of a split.
            tasks: Names of tasks; all if empty.
            columns: Besides the maps.
            language: Which sentences.
            shared: Whether processes of this machine share the maps: the first writes
                them uncompressed into the folder ``.maps`` of the data set, and all map
                that file into their memory. Maps of earlier content are deleted.

        Raises:
            DatasetError: Files are missing or damaged, or the maps cannot be written.
        """
        if shared:
            return cls._load_shared(Path(folder), split, tasks, columns, language)
        dataset = KeyframeDataset(
            folder, split, tasks, (*MAP_COLUMNS, *columns), language
        )
        count, raster = len(dataset), dataset.raster
        rgb = np.empty((count, raster.rows, raster.columns, 3), np.uint8)
        height = np.empty((count, raster.rows, raster.columns), np.uint16)
        rest: dict[str, list[Any]] = {}

        def read(index: int) -> Sample:
            sample = dataset[index]
            rgb[index], height[index] = sample.pop("map_rgb"), sample.pop("map_height")
            del sample["map_coverage"]
            return sample

        # Allocation and decompression take most of the time, and release the lock.
        with ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
            for sample in pool.map(read, range(count)):
                for name, value in sample.items():
                    rest.setdefault(name, []).append(value)
        return cls(rgb, height, _arrays(rest), raster)

    @classmethod
    def _load_shared(
        cls,
        folder: Path,
        split: str,
        tasks: Sequence[str],
        columns: Sequence[str],
        language: Language,
    ) -> "MapsInMemory":
        labels = KeyframeDataset(folder, split, tasks, columns, language)
        place = folder / SHARED
        stem = "-".join((split, *tasks))
        # Named by content: the files of the folder may have been replaced.
        content = _content(folder, labels.shards)
        paths = [place / f"{stem}.{content}.{name}.npy" for name in ("rgb", "height")]
        try:
            place.mkdir(exist_ok=True)
            with FileLock(place / f"{stem}.lock"):
                if not all(path.exists() for path in paths):
                    for old in place.glob(f"{glob.escape(stem)}.*.npy"):
                        old.unlink()
                    maps = cls.load(folder, split, tasks, ())
                    _save(paths[0], maps.rgb)
                    _save(paths[1], maps.height)
                # Writable, as torch asks; a page that is written to is copied.
                rgb, height = (np.load(path, mmap_mode="c") for path in paths)
        except (OSError, ValueError) as error:
            raise DatasetError(
                f"The maps cannot be shared through {place}: {error}. Leave out "
                "--shared-images, or delete that folder."
            ) from error
        rest: dict[str, list[Any]] = {}
        for index in range(len(labels)):
            for name, value in labels[index].items():
                rest.setdefault(name, []).append(value)
        return cls(rgb, height, _arrays(rest), labels.raster)


def _content(folder: Path, shards: Sequence[Shard]) -> str:
    """Return a digest of the files that the maps come from."""
    files = listed_files(folder)
    paths = (shard.paths["maps"].relative_to(folder).as_posix() for shard in shards)
    sums = "".join(files[path]["sha256"] for path in paths)
    return sha256(sums.encode()).hexdigest()[:16]


def _save(path: Path, array: NDArray[Any]) -> None:
    def write(draft: Path) -> None:
        with draft.open("wb") as file:
            np.save(file, array)

    write_whole(path, write)


def _arrays(columns: dict[str, list[Any]]) -> dict[str, NDArray[Any]]:
    return {
        name: np.array(values, object if isinstance(values[0], str) else None)
        for name, values in columns.items()
    }
