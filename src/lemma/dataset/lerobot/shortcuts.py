"""What lerobot does for every frame that it writes, and need not do for ours.

Without these, statistics of pictures and copies of tables take several times as long as
rendering on a GPU. What is written is the same, but for the rounding of statistics.
"""

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray

_LEVELS = 256
_TAKEN = "_counts_levels"


def take_shortcuts() -> None:
    """Replace two parts of the lerobot package in this process; once is enough."""
    statistics = import_module("lerobot.datasets.compute_stats")
    kind = statistics.RunningQuantileStats
    if not hasattr(kind, _TAKEN):
        quantiles = tuple(statistics.DEFAULT_QUANTILES)
        vars(statistics)["RunningQuantileStats"] = counting(kind, quantiles)
    writer = import_module("lerobot.datasets.dataset_writer")
    # Row by row it looks for pictures to put into the table; ours are in videos.
    vars(writer)["embed_images"] = _nothing_to_embed


def _nothing_to_embed(dataset: Any) -> Any:
    return dataset


def counting(kind: type, quantiles: tuple[float, ...]) -> type:
    """Return a kind of running statistics that counts the levels of 8-bit pictures.

    Rows that are all the same, as a sentence is in all frames of an episode, are not
    looked at one by one either.

    Args:
        kind: The one of lerobot, which sorts every number into 5,000 bins. It is still
            used for what is no 8-bit picture and changes.
        quantiles: Which ones are wanted, from 0 to 1.
    """

    class Counting(kind):  # type: ignore[misc]
        _counts_levels = True
        _counts: NDArray[np.int64] | None = None
        _same: NDArray[Any] | None = None
        _changes = False

        def update(self, batch: NDArray[Any]) -> None:
            if batch.dtype == np.uint8:
                found = [np.bincount(row, minlength=_LEVELS) for row in batch.T]
                before = 0 if self._counts is None else self._counts
                self._counts = before + np.array(found)
            elif not self._changes and self._same is None and is_constant(batch):
                self._same = batch
            else:
                if self._same is not None:
                    super().update(self._same)
                self._same, self._changes = None, True
                super().update(batch)

        def get_statistics(self) -> dict[str, Any]:
            if self._counts is not None:
                return statistics_of_levels(self._counts, quantiles)
            if self._same is not None:
                return statistics_of_one_row(self._same[0], len(self._same), quantiles)
            told: dict[str, Any] = super().get_statistics()
            return told

    return Counting


def is_constant(batch: NDArray[Any]) -> bool:
    """Return whether an array has rows, and all of them are the same."""
    return batch.ndim > 1 and len(batch) > 0 and bool((batch == batch[0]).all())


def statistics_of_one_row(
    row: NDArray[Any], count: int, quantiles: tuple[float, ...]
) -> dict[str, NDArray[Any]]:
    """Return statistics of rows that are all the same, as lerobot names them.

    Args:
        row: The row, shape (columns,).
        count: How many there are.
        quantiles: Which ones are wanted, from 0 to 1.
    """
    value = row.astype(np.result_type(row.dtype, np.float32))
    return {
        **{name: value.copy() for name in ("min", "max", "mean")},
        "std": np.zeros_like(value),
        "count": np.array([count]),
        **{
            _quantile_name(quantile): value.astype(np.float64) for quantile in quantiles
        },
    }


def _quantile_name(quantile: float) -> str:
    return f"q{int(quantile * 100):02d}"


def statistics_of_levels(
    counts: NDArray[np.int64], quantiles: tuple[float, ...]
) -> dict[str, NDArray[Any]]:
    """Return statistics of 8-bit numbers, as lerobot names them.

    Args:
        counts: How often each level occurs, shape (channels, 256).
        quantiles: Which ones are wanted, from 0 to 1.

    Returns:
        ``min``, ``max``, ``mean``, ``std`` and the quantiles (``q01``), shape
        (channels,), and ``count``, shape (1,).
    """
    levels = np.arange(_LEVELS)
    total = int(counts[0].sum())
    mean: FloatArray = counts @ levels / total
    variance: FloatArray = counts @ levels**2 / total - mean**2
    there = counts > 0
    up_to = counts.cumsum(axis=1)
    return {
        "min": there.argmax(axis=1).astype(np.float64),
        "max": _LEVELS - 1.0 - there[:, ::-1].argmax(axis=1),
        "mean": mean,
        "std": np.sqrt(np.maximum(0.0, variance)),
        "count": np.array([total]),
        **{
            _quantile_name(quantile): (up_to >= quantile * total)
            .argmax(axis=1)
            .astype(np.float64)
            for quantile in quantiles
        },
    }
