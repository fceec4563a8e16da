"""Records of the trainings behind the results: duration, speed and end.

    python scripts/trainings.py runs/seed-0/* runs/ablations/*

copies the reports of ``lemma train`` of these runs to results/trainings/.
``scripts/results.py`` makes a table and a figure of the validation curves from them.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from lemma.core.errors import DatasetError
from lemma.core.files import read_json, write_json
from lemma.core.tables import Table
from lemma.evaluation.experiments.catalog import ABLATIONS, EXPERIMENTS
from lemma.policies.models.catalog import MODELS
from lemma.viz.plots import Figure, Mark, Series, lines

FOLDER = Path(__file__).parents[1] / "results" / "trainings"
TENTHS = 10
"""Default number of validations of a training."""


@dataclass(frozen=True)
class Training:
    """One training, with one seed."""

    name: str
    """Name of its weights."""
    seed: int
    samples: int
    """Number of drawn frames."""
    seconds: float
    """Time of the training [s]."""
    samples_per_s: float
    """Frames per second, without validation and checkpoints."""
    gpu_memory_gb: float
    device: str
    status: str
    """``finished``, or ``time is up``."""
    selection: str
    """Name of the score that selects the best weights."""
    curve: tuple[float, ...]
    """This score at each validation, from 0 to 1."""
    command: str
    shares: tuple[float, ...] = ()
    """Share of the training at each validation; evenly spaced ones if empty."""


def training_of(run: Path) -> Training:
    """Return the record of a run.

    Args:
        run: Folder of the run, ``.../seed-SEED/NAME``, with ``report.json``.

    Raises:
        DatasetError: The run has no report.
    """
    return training_from(read_json(run / "report.json"), run.name)


def training_from(report: Mapping[str, object], name: str) -> Training:
    """Return the record from the report of a run.

    Args:
        report: The contents of ``report.json``.
        name: Name of the weights.
    """
    parsed = msgspec.convert(report, _Report)
    selection = MODELS[parsed.model][0].selection
    seed = parsed.command.partition("--seed ")[2].split()
    return Training(
        name=name,
        seed=int(seed[0]) if seed else 0,
        samples=parsed.samples,
        seconds=round(parsed.seconds, 1),
        samples_per_s=round(parsed.samples_per_s, 1),
        gpu_memory_gb=round(parsed.gpu_memory_gb, 1),
        device=parsed.device,
        status=parsed.status,
        selection=selection,
        curve=tuple(round(one[selection], 4) for one in parsed.history),
        command=parsed.command,
        shares=tuple(round(one["step"] / parsed.steps, 3) for one in parsed.history),
    )


class _Report(msgspec.Struct):
    """The fields of a report that a record needs."""

    model: str
    samples: int
    steps: int
    seconds: float
    samples_per_s: float
    gpu_memory_gb: float
    device: str
    status: str
    history: list[dict[str, float]]
    command: str


def read_trainings(folder: Path = FOLDER) -> list[Training]:
    """Return all records, by name and seed.

    Raises:
        DatasetError: A record is damaged.
    """
    found = []
    for path in sorted(folder.glob("*.json")):
        try:
            found.append(msgspec.convert(read_json(path), Training))
        except msgspec.ValidationError as error:
            raise DatasetError(f"{path} is no training: {error}.") from error
    return found


def training_table(trainings: Sequence[Training]) -> Table:
    """Return a row for each training."""
    rows = (
        (
            one.name,
            one.device,
            f"{one.seed}",
            f"{one.samples:,}",
            f"{one.seconds:.0f}",
            f"{one.samples_per_s:.0f}",
            f"{one.gpu_memory_gb:.0f}",
            f"`{one.selection}` {100 * max(one.curve):.1f}",
            f"{100 * (one.curve[-1] - one.curve[len(one.curve) * 4 // 5 - 1]):+.1f}",
        )
        for one in trainings
    )
    header = (
        *("weights", "device", "seed", "frames", "seconds", "frames/s", "memory [GB]"),
        *("best validation [%]", "change in the last fifth [points]"),
    )
    return Table(header, tuple(rows), labels=2)


def validation_figure(trainings: Sequence[Training]) -> Figure:
    """Return the validation curves of first seeds, each at the nearest tenth.

    A record without shares needs ten validations. Ablations are left out.
    """
    every = EXPERIMENTS.values()
    ablations = {one.policy.name for one in every if one.suite == ABLATIONS}
    shown: dict[str, Training] = {}
    for one in trainings:
        # A step count that ten does not divide leaves one more validation at the end.
        whole = one.shares or len(one.curve) in (TENTHS, TENTHS + 1)
        if whole and one.name not in ablations:
            shown.setdefault(one.name, one)
    series = [
        Series(f"{one.name}: {one.selection}", marks_of(one)) for one in shown.values()
    ]
    parts = [f"{10 * (k + 1)}" for k in range(TENTHS)]
    axes = "share of the training [%]", "validation score [%]"
    return Figure(
        "validation",
        "Validation while training",
        "The score by which the best weights are chosen; each model has its own.",
        lines(parts, series, axes),
    )


def marks_of(one: Training) -> tuple[Mark | None, ...]:
    """Return the scores at the tenths of a training; None where there is no score."""
    shares = one.shares or [(k + 1) / TENTHS for k in range(TENTHS)]
    at = {
        round(TENTHS * share): Mark(value, value, value, f"{value:.1%}")
        for share, value in zip(shares, one.curve, strict=False)
    }
    return tuple(at.get(k + 1) for k in range(TENTHS))


def main() -> None:
    """Write the records of the runs on the command line."""
    for argument in sys.argv[1:]:
        run = Path(argument)
        one = training_of(run)
        write_json(FOLDER / f"{one.name}-seed-{one.seed}.json", asdict(one))


if __name__ == "__main__":
    main()
