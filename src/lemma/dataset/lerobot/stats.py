"""Statistics of features, as the format wants them: by episode and of the whole.

The whole is put together from the episodes, so that no number of episodes fills the
memory: mean, deviation and extremes are exact, quantiles are means of the episodes'
quantiles, weighted by their frames, which is how LeRobot itself does it.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lemma.core.poses import FloatArray

Stats = dict[str, Any]
"""Name of a figure to nested lists of numbers."""

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
FIGURES = ("min", "max", "mean", "std", "count", *_QUANTILES)
"""Every figure that is given."""

_STRIDE_PX = 2


def describe(values: ArrayLike) -> Stats:
    """Return the figures of the columns of an array.

    Args:
        values: Shape (frames, size), or (frames,) for a single column.
    """
    array = np.asarray(values, dtype=np.float64)
    array = array.reshape(len(array), -1)
    found = {
        "min": array.min(axis=0).tolist(),
        "max": array.max(axis=0).tolist(),
        "mean": array.mean(axis=0).tolist(),
        "std": array.std(axis=0).tolist(),
        "count": [len(array)],
    }
    for name, quantile in _QUANTILES.items():
        found[name] = np.quantile(array, quantile, axis=0).tolist()
    return found


class Histogram:
    """How often every level occurs in the pictures of a video, by channel.

    Every second pixel of every second row is counted.
    """

    def __init__(self, channels: int, levels: int) -> None:
        """Count nothing yet.

        Args:
            channels: Channels of a picture.
            levels: Number of levels that a pixel can have.
        """
        self._counts = np.zeros((channels, levels), np.int64)
        self._frames = 0

    def add(self, picture: NDArray[Any]) -> None:
        """Count a picture, shape (height, width) or (height, width, channels)."""
        rows = picture[::_STRIDE_PX, ::_STRIDE_PX].reshape(-1, len(self._counts))
        for channel, counts in enumerate(self._counts):
            counts += np.bincount(rows[:, channel], minlength=counts.size)
        self._frames += 1

    def describe(self, level: float) -> Stats:
        """Return the figures, each of shape (channels, 1, 1).

        Args:
            level: What one level stands for.
        """
        columns = [self._column(counts, level) for counts in self._counts]
        found: Stats = {
            name: [[[column[name]]] for column in columns] for name in columns[0]
        }
        return {**found, "count": [self._frames]}

    @staticmethod
    def _column(counts: NDArray[np.int64], level: float) -> dict[str, float]:
        values = np.arange(counts.size) * level
        total = int(counts.sum())
        mean = float((counts * values).sum() / total)
        variance = float((counts * (values - mean) ** 2).sum() / total)
        seen = np.flatnonzero(counts)
        upto = np.cumsum(counts)

        def quantile(share: float) -> float:
            place = (total - 1) * share
            below = float(values[np.searchsorted(upto, math.floor(place), "right")])
            above = float(values[np.searchsorted(upto, math.ceil(place), "right")])
            return below + (above - below) * (place - math.floor(place))

        return {
            "min": float(values[seen[0]]),
            "max": float(values[seen[-1]]),
            "mean": mean,
            "std": math.sqrt(variance),
            **{name: quantile(share) for name, share in _QUANTILES.items()},
        }


class Total:
    """The figures of one feature over all episodes."""

    def __init__(self) -> None:
        """Begin with no episode."""
        self._count = 0
        self._mean: FloatArray = np.array(0.0)
        self._squares: FloatArray = np.array(0.0)
        self._least: FloatArray = np.array(np.inf)
        self._most: FloatArray = np.array(-np.inf)
        self._quantiles = {name: np.array(0.0) for name in _QUANTILES}

    def add(self, stats: Stats) -> None:
        """Add an episode's figures."""
        count = stats["count"][0]
        share = count / (self._count + count)
        off = np.asarray(stats["mean"]) - self._mean
        # Chan's way of joining deviations: nothing large is taken from another.
        self._squares = (
            self._squares
            + count * np.asarray(stats["std"]) ** 2
            + self._count * share * off**2
        )
        self._mean = self._mean + share * off
        for name, mean in self._quantiles.items():
            self._quantiles[name] = mean + share * (np.asarray(stats[name]) - mean)
        self._least = np.minimum(self._least, stats["min"])
        self._most = np.maximum(self._most, stats["max"])
        self._count += count

    def figures(self) -> Stats:
        """Return the figures of all episodes together."""
        return {
            "min": self._least.tolist(),
            "max": self._most.tolist(),
            "mean": self._mean.tolist(),
            "std": np.sqrt(self._squares / self._count).tolist(),
            "count": [self._count],
            **{name: mean.tolist() for name, mean in self._quantiles.items()},
        }
