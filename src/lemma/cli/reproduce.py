"""`lemma reproduce`: the experiments of the tables, with the published weights."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import tyro

from lemma.cli.options import Flag, Folder, Number, complain, messages, output
from lemma.cli.report import print_written
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import DatasetError
from lemma.core.files import write_text
from lemma.evaluation.experiments.catalog import Experiment, selected
from lemma.evaluation.experiments.reproduction import (
    MissingWeightsError,
    Reproduction,
    check_experiment,
    commands,
)
from lemma.evaluation.protocol.rules import check_protocol, quote
from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.evaluation.report.sections import REPORT, page
from lemma.policies.class_path import checkpoint_of

_AT_INTERRUPT = (
    "{done} of {total} episodes of this experiment are saved. The same command "
    "continues from there."
)


def reproduce(
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results"),
    weights: Folder = None,
    check: Flag = False,
    split: Annotated[str, tyro.conf.arg(metavar="SPLIT")] = "test",
    episodes: Number = None,
    device: Literal["cpu", "cuda"] = "cpu",
    working: WorkerOptions = DEFAULT,
    print_commands: Annotated[Flag, tyro.conf.arg(name="print")] = False,
) -> int:
    """Evaluate every row of the tables, and write the tables.

    Finished episodes are saved, so the same command continues an interrupted run.
    Rows with missing weights are skipped and named; the command fails if all are.

    Args:
        name: paper, reachnet-variants, controls, control-level, ablations; all, without
            the last two; or one experiment.
        out: Folder of all results: one folder per experiment, one file per training
            seed.
        weights: Folder with one training run for each name of weights; by default
            the published ones.
        check: Write nothing: play the first episode of each task and kind, or
            --episodes of them, and compare them with the published lines in --out.
        split: Frozen list of instances.
        episodes: Number of episodes of every task, from the first; for trials.
        device: Device of the models, with float32 on both.
        working: Options of the workers.
        print_commands: Only print the commands that train and evaluate the weights of
            all seeds.
    """
    experiments = selected(name)
    if check:
        return _check(experiments, out, episodes or 1, device, working)
    if print_commands:
        for line in commands(experiments):
            output().print(line, soft_wrap=True)
        return 0
    plan = Reproduction(
        out=out, weights=weights, split=split, episodes=episodes, device=device
    )
    for result in read_results([out]) if out.exists() else []:
        check_protocol({"protocol": quote()}, result.about, "This command", out)
    evaluated = _evaluate(experiments, plan, working)
    entries = entries_of(read_results([out]) if out.exists() else [], complete=True)
    write_text(out / REPORT, page(entries))
    print_written(out / REPORT, entries)
    if not evaluated:
        complain("Nothing was evaluated.")
        return 1
    return 0


def _evaluate(
    experiments: list[Experiment], plan: Reproduction, working: WorkerOptions
) -> int:
    """Evaluate all experiments whose weights exist; return their number."""
    engine, evaluated = working.make_engine(), 0
    for experiment in experiments:
        try:
            config, _ = plan.config(experiment)
        except MissingWeightsError as error:
            messages().print(f"Skipped {experiment.name}: {error}", soft_wrap=True)
            continue
        with progress_bar(experiment.name, config.total, _AT_INTERRUPT) as advance:
            plan.run(experiment, engine, advance)
        evaluated += 1
    return evaluated


def _check(
    experiments: list[Experiment],
    results: Path,
    episodes: int,
    device: str,
    working: WorkerOptions,
) -> int:
    """Compare policies with published lines; return 1 if one differs or all skip."""
    failed = compared = 0
    for experiment in experiments:
        name = experiment.name
        checkpoint = checkpoint_of(experiment.policy.name)
        if checkpoint is not None and find_spec("lerobot") is None:
            messages().print(f"Skipped {name}: lerobot is not installed here.")
            continue
        try:
            engine = working.make_engine()
            found = check_experiment(experiment, results, episodes, engine, device)
        except MissingWeightsError as error:
            messages().print(f"Skipped {name}: {error}", soft_wrap=True)
            continue
        except DatasetError as error:
            complain(f"{name}: {error}")
            failed += 1
            continue
        compared += 1
        failed += not found.ok
        for difference in found.differing:
            output().print(f"{name} {difference}", soft_wrap=True, markup=False)
        output().print(
            f"{name}: {found.episodes - len(found.differing)} of {found.episodes} "
            "episodes are equal to the published lines; poses within "
            f"{1e3 * found.farthest_m:.4f} mm",
            soft_wrap=True,
            markup=False,
        )
    if not compared:
        complain("Nothing was compared.")
    return int(failed > 0 or not compared)
