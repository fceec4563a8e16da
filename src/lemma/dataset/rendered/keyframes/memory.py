"""The maps of a split in memory, for the fastest training loop."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.dataset.instructions import RECORDED, Language
from lemma.dataset.rendered.keyframes.dataset import (
    MAP_COLUMNS,
    POLICY_COLUMNS,
    KeyframeDataset,
    Sample,
)
from lemma.scene.raster import Raster

_THREADS = 16


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
