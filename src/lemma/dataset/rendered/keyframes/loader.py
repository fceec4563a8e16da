"""Rendered keyframes for a training loop: batches read ahead, or all in memory.

Batches of maps are tens of megabytes. Handing them from process to process costs more
than reading them, so threads, which share memory, are faster than processes here.
"""

import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError
from lemma.core.seeding import stream
from lemma.dataset.instructions import RECORDED, Language
from lemma.dataset.rendered.keyframes.dataset import (
    MAP_COLUMNS,
    POLICY_COLUMNS,
    KeyframeDataset,
    Sample,
)
from lemma.scene.raster import Raster

_THREADS = 16


@dataclass(frozen=True, kw_only=True)
class KeyframeLoader:
    """Batches of a data set, read ahead: ``for batch in loader``.

    The order depends on the seed and on the data set's epoch alone.
    """

    dataset: KeyframeDataset
    batch_size: int = 32
    shuffle: bool = True
    seed: int = 0
    """Of the order."""
    drop_last: bool = False
    """Whether to leave out a last batch that is not full."""
    threads: int = 2
    """Threads that read ahead, two batches each."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.batch_size < 1 or self.threads < 1:
            raise InvalidConfigError(
                f"batch_size and threads are 1 or more, not {self.batch_size} and "
                f"{self.threads}."
            )

    def __len__(self) -> int:
        """Return the number of batches."""
        full, rest = divmod(len(self.dataset), self.batch_size)
        return full + (rest > 0 and not self.drop_last)

    def __iter__(self) -> Iterator[Sample]:
        """Yield batches; see :meth:`KeyframeDataset.batch`."""
        order = np.arange(len(self.dataset))
        if self.shuffle:
            order = stream("shuffle", self.seed, self.dataset.epoch).permutation(order)
        size = self.batch_size
        batches = iter([order[i * size : (i + 1) * size] for i in range(len(self))])
        ahead: deque[Future[Sample]] = deque()
        pool = ThreadPoolExecutor(self.threads)
        try:
            while True:
                while len(ahead) < 2 * self.threads:
                    following = next(batches, None)
                    if following is None:
                        break
                    ahead.append(pool.submit(self.dataset.batch, following))
                if not ahead:
                    return
                yield ahead.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class MapsInMemory:
    """The maps of all keyframes of a split, with their labels, for the fastest loop.

    0.6 MB per keyframe with maps of the usual size.
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
    ) -> "MapsInMemory":
        """Read everything; the arguments are those of :class:`KeyframeDataset`."""
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

        # Most of the time goes into new memory and decompression, without the lock.
        with ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
            for sample in pool.map(read, range(count)):
                for name, value in sample.items():
                    rest.setdefault(name, []).append(value)
        found = {
            name: np.array(values, object if isinstance(values[0], str) else None)
            for name, values in rest.items()
        }
        return cls(rgb, height, found, raster)
