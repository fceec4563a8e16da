"""Learning curves: success on split val during the training of a policy."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from lemma.core.errors import DatasetError
from lemma.core.files import read_json
from lemma.core.tables import Table
from lemma.evaluation.experiments.catalog import EXPERIMENTS

CURVE = "curve.json"
"""File of a learning curve, beside the results of its experiment."""


@dataclass(frozen=True)
class Point:
    """An evaluated checkpoint."""

    steps: int
    """Number of training steps."""
    episodes: int
    """Number of episodes of split val."""
    successes: int
    """Number of strict successes."""


@dataclass(frozen=True)
class LearningCurve:
    """Checkpoints of one training, by number of steps."""

    points: tuple[Point, ...]


def read_curves(results: Path) -> dict[str, LearningCurve]:
    """Return the learning curves in a folder of results, by experiment.

    Raises:
        DatasetError: A file is damaged.
    """
    found = {}
    for name in EXPERIMENTS:
        path = results / name / CURVE
        if path.exists():
            try:
                found[name] = msgspec.convert(read_json(path), LearningCurve)
            except msgspec.ValidationError as error:
                raise DatasetError(f"{path} is no learning curve: {error}.") from error
    return found


def learning_curves(curves: Mapping[str, LearningCurve]) -> Table:
    """Return a row for each checkpoint; curves are by experiment."""
    rows = (
        (
            EXPERIMENTS[name].title,
            f"{point.steps:,}",
            f"{point.episodes}",
            f"{100.0 * point.successes / point.episodes:.1f}",
        )
        for name, curve in curves.items()
        for point in curve.points
    )
    return Table(("policy", "steps", "episodes", "success [%]"), tuple(rows))
