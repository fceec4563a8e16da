"""Learning curves: success on split val while a policy was being trained."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from lemma.core.errors import DatasetError
from lemma.core.files import read_json, write_json
from lemma.core.tables import Table
from lemma.evaluation.experiments.catalog import EXPERIMENTS

CURVE = "curve.json"
"""File of a curve, beside the results of its experiment."""


@dataclass(frozen=True)
class Point:
    """A checkpoint that was evaluated."""

    steps: int
    """Steps of the training."""
    episodes: int
    """Episodes of split val that were played."""
    successes: int
    """Strictly."""


@dataclass(frozen=True)
class LearningCurve:
    """Checkpoints of one training, by number of steps."""

    points: tuple[Point, ...]

    def write(self, path: Path) -> None:
        """Write it as JSON.

        Raises:
            DatasetError: The disk is full, or the folder cannot be written to.
        """
        write_json(path, asdict(self))


def read_curves(results: Path) -> dict[str, LearningCurve]:
    """Return the curves in a folder of results, by experiment.

    Raises:
        DatasetError: One is damaged.
    """
    return dict(_curves_in(results))


def _curves_in(results: Path) -> Iterator[tuple[str, LearningCurve]]:
    for name in EXPERIMENTS:
        path = results / name / CURVE
        if path.exists():
            try:
                yield name, msgspec.convert(read_json(path), LearningCurve)
            except msgspec.ValidationError as error:
                raise DatasetError(f"{path} is no learning curve: {error}.") from error


def learning_curves(curves: Mapping[str, LearningCurve]) -> Table:
    """Return a row for each checkpoint.

    Args:
        curves: By experiment.
    """
    header = ("policy", "steps", "episodes", "success [%]")
    rows = tuple(
        (
            EXPERIMENTS[name].title,
            f"{point.steps:,}",
            f"{point.episodes}",
            f"{100.0 * point.successes / point.episodes:.1f}",
        )
        for name, curve in curves.items()
        for point in curve.points
    )
    return Table(header, rows)
