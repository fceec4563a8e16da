"""Records of the trainings behind the results: duration, speed and end.

    python scripts/trainings.py runs/seed-0/* runs/ablations/*

copies the reports of ``lemma train`` or of ``scripts/train_lerobot_policy.py`` of these
runs to results/trainings/.
``scripts/results.py`` makes a table and a figure of the validation curves from them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from lemma.core.errors import DatasetError
from lemma.core.files import read_json, write_json
from lemma.core.tables import Table
from lemma.evaluation.experiments.catalog import ABLATIONS, EXPERIMENTS
from lemma.evaluation.report.policy_results import NOTHING
from lemma.policies.models.catalog import MODELS
from lemma.viz.plots import Curve, Figure, curves

FOLDER = Path(__file__).parents[1] / "results" / "trainings"
TENTHS = 10
"""Default number of validations of a training."""
LAST_FIFTH = 0.8


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
    """0 if unknown."""
    device: str
    status: str
    """``finished``, or ``time is up``."""
    selection: str
    """Name of the score that selects the best weights; empty if the last are used."""
    curve: tuple[float, ...]
    """This score at each validation, from 0 to 1."""
    command: str
    shares: tuple[float, ...] = ()
    """Share of the training at each validation; see :func:`shares_of` if empty."""


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
    selection = MODELS[parsed.model][0].selection if parsed.history else ""
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
        curve=tuple(round(one[selection], 6) for one in parsed.history),
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
    for path in folder.glob("*.json"):
        try:
            found.append(msgspec.convert(read_json(path), Training))
        except msgspec.ValidationError as error:
            raise DatasetError(f"{path} is no training: {error}.") from error
    return sorted(found, key=lambda one: (one.name, one.seed))


def shares_of(one: Training) -> tuple[float, ...]:
    """Return the share of a training at each score; empty if nobody knows.

    Without recorded shares the usual number of validations is at tenths, and a step
    count that ten does not divide leaves one more at the end. A training that a time
    limit ended has others.
    """
    if one.shares:
        return one.shares
    tenths = tuple((k + 1) / TENTHS for k in range(TENTHS))
    usual = {len(each): each for each in (tenths, (*tenths, 1.0))}
    return usual.get(len(one.curve), ())


def late_change(one: Training) -> float | None:
    """Return the change of the score in the last fifth of a training; None if unknown.

    Its beginning is interpolated between the two validations around it.
    """
    shares = shares_of(one)
    for k in range(1, len(shares)):
        before, after = shares[k - 1], shares[k]
        if before <= LAST_FIFTH + 1e-9 and after > LAST_FIFTH:
            part = (LAST_FIFTH - before) / (after - before)
            begin = one.curve[k - 1] + part * (one.curve[k] - one.curve[k - 1])
            return one.curve[-1] - begin
    return None


def seconds_by_name(trainings: Iterable[Training]) -> dict[str, str]:
    """Return the seconds of the trainings of each name, in the order of seeds."""
    found: dict[str, list[str]] = {}
    for one in trainings:
        found.setdefault(one.name, []).append(f"{one.seconds:.0f}")
    return {name: ", ".join(each) for name, each in found.items()}


def training_table(trainings: Sequence[Training]) -> Table:
    """Return a row for each training."""
    rows = (
        (
            one.name,
            one.device,
            f"{one.seed}",
            f"{one.samples:,}",
            f"{one.seconds:.0f}",
            "steps" if one.status == "finished" else "time",
            f"{one.samples_per_s:.0f}",
            f"{one.gpu_memory_gb:.0f}" if one.gpu_memory_gb else NOTHING,
            f"`{one.selection}` {100 * max(one.curve):.1f}" if one.curve else NOTHING,
            NOTHING if change is None else f"{100 * change:+.1f}",
        )
        for one in trainings
        for change in [late_change(one)]
    )
    header = (
        *("weights", "device", "seed", "frames", "seconds", "ended by", "frames/s"),
        *("memory [GB]", "best validation [%]", "change in the last fifth [points]"),
    )
    return Table(header, tuple(rows), labels=2)


def plotted(trainings: Iterable[Training]) -> list[Training]:
    """Return the trainings of the figure: with known shares, and no ablations."""
    every = EXPERIMENTS.values()
    ablations = {one.policy.name for one in every if one.suite == ABLATIONS}
    return [one for one in trainings if shares_of(one) and one.name not in ablations]


def validation_figure(trainings: Iterable[Training]) -> Figure:
    """Return the validation curves of :func:`plotted` trainings, all seeds."""
    drawn = [
        Curve(
            f"{one.name}: {one.selection}",
            f"{one.name}, seed {one.seed}",
            tuple(
                (100.0 * share, 100.0 * score)
                for share, score in zip(shares_of(one), one.curve, strict=True)
            ),
        )
        for one in plotted(trainings)
    ]
    axes = "share of the training [%]", "validation score [%]"
    return Figure(
        "validation",
        "Validation while training",
        "The score by which the best weights are chosen; each model has its own.",
        curves(drawn, axes, (0.0, 100.0)),
    )


def undrawn(trainings: Iterable[Training]) -> str:
    """Return a further sentence, about trainings that the figure lacks, if any."""
    missing = [
        f"`{one.name}` of seed {one.seed}"
        for one in trainings
        if one.curve and not shares_of(one)
    ]
    if not missing:
        return " Not drawn: ablations, and trainings without validation."
    return (
        f" Not drawn: ablations, trainings without validation, and "
        f"{', '.join(missing)}, whose record does not say when it was validated."
    )


def main(runs: Annotated[tuple[Path, ...], tyro.conf.Positional]) -> None:
    """Write the records of some trainings to results/trainings/.

    Args:
        runs: Folders of the trainings, such as runs/seed-0/*.
    """
    for run in runs:
        one = training_of(run)
        write_json(FOLDER / f"{one.name}-seed-{one.seed}.json", asdict(one))


if __name__ == "__main__":
    tyro.cli(main)
