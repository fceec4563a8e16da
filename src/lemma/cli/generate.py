"""`lemma generate`: the expert's demonstrations of the suite, as a recipe."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import tyro

from lemma.cli.options import (
    ALL,
    Folder,
    JsonFlag,
    Listed,
    Number,
    SuiteName,
    output,
    print_figures,
    print_json,
    task_names,
    words,
)
from lemma.cli.workers import AT_INTERRUPT, DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import InvalidConfigError
from lemma.dataset.recipe.files import load
from lemma.dataset.recipe.generate import GenerateConfig, GenerateSummary
from lemma.dataset.recipe.generate import generate as write_recipe
from lemma.dataset.recipe.replay import differing
from lemma.dataset.recipe.summary import RecoveryFigures, recovery_figures
from lemma.expert.disturbances import Perturbation
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.suite import FREE_SPLIT, SUITE, has_frozen_lists

_RECIPE = Path(f"data/lemma-{BENCHMARK_VERSION}")
_RECOVERY = Path(f"data/lemma-{BENCHMARK_VERSION}-recovery")
_FORMS = {
    "episodes": ("episodes", "{:.0f}"),
    "made": ("made by this run", "{:.0f}"),
    "seconds": ("seconds", "{:.1f}"),
    "workers": ("workers", "{:.0f}"),
    "episodes_per_s": ("episodes per second", "{:.2f}"),
    "episodes_per_s_and_worker": ("the same per worker", "{:.2f}"),
    "size_mb": ("size on disk", "{:.1f} MB"),
    "worker_mb": ("peak memory of a worker", "{:.0f} MB"),
}
_IF_NOTHING_WAS_MADE = ("episodes", "made", "size_mb")


def generate(
    tasks: Listed = ALL,
    suite: SuiteName = "lemma",
    split: Annotated[
        str | None, tyro.conf.arg(metavar="SPLIT,...", help_behavior_hint="")
    ] = None,
    episodes: Number = None,
    perturb: Annotated[
        float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")
    ] = None,
    perturb_seed: int = 0,
    out: Folder = None,
    working: WorkerOptions = DEFAULT,
    resume: bool = True,
    as_json: JsonFlag = False,
) -> int:
    """Let the expert solve the frozen instances, and record its episodes.

    Existing files are kept, so the same command continues an interrupted run.

    Args:
        tasks: Names of tasks, separated by commas.
        suite: Suite whose tasks are solved unless --tasks names some.
        split: Names of splits, separated by commas; all frozen ones by default, train
            with --perturb, free for your own tasks. Split free needs --episodes.
        episodes: Number of episodes of every task and split; all by default.
        perturb: Make recovery states instead of demonstrations: each sub-task is
            disturbed with this probability, such as 0.3, and the expert's decision is
            recorded as a label.
        perturb_seed: With --perturb: seed of the disturbances.
        out: Folder of the recipe; data/lemma-v3 by default, and
            data/lemma-v3-recovery with --perturb.
        working: Options of the workers.
        resume: Complete an existing folder; otherwise it must be empty.
        as_json: Print one JSON object instead of a table.
    """
    order = order_of(
        task_names(tasks, suite), split, episodes, perturb, perturb_seed, out
    )
    out = order.out
    if not resume and out.is_dir() and any(out.iterdir()):
        raise InvalidConfigError(
            f"{out} is not empty. Leave out --no-resume to complete it, or choose "
            "another folder; files are never deleted."
        )
    engine = working.make_engine()
    with progress_bar("generate", order.total, AT_INTERRUPT) as advance:
        found = figures(write_recipe(order, engine, advance), engine.workers)
    recovery = recovery_figures(load(out)) if order.perturb else None
    others = None if recovery else differing(out)
    if as_json:
        details = {"recovery": asdict(recovery)} if recovery else {"differing": others}
        print_json({**found, **details})
        return 0
    shown = _FORMS if found["made"] else {n: _FORMS[n] for n in _IF_NOTHING_WAS_MADE}
    print_figures(found, shown, str(out))
    if recovery:
        _print_recovery(recovery)
    _print_comparison(others)
    return 0


def order_of(
    names: tuple[str, ...] = SUITE,
    split: str | None = None,
    episodes: int | None = None,
    perturb: float | None = None,
    perturb_seed: int = 0,
    out: Path | None = None,
) -> GenerateConfig:
    """Return the configuration for options of :func:`generate`.

    Raises:
        InvalidConfigError: ``perturb_seed`` without ``perturb``.
        LemmaError: A name is unknown.
    """
    if perturb is None and perturb_seed:
        raise InvalidConfigError(
            "--perturb-seed has no effect without --perturb. Add --perturb 0.3."
        )
    mistakes = None if perturb is None else Perturbation(perturb, perturb_seed)
    splits = ("train",) if mistakes else tuple(SPLITS)
    if split:
        splits = words(split)
    elif not all(map(has_frozen_lists, names)):
        splits = (FREE_SPLIT,)
    return GenerateConfig(
        out=out or (_RECOVERY if mistakes else _RECIPE),
        tasks=names,
        splits=splits,
        episodes=episodes,
        perturb=mistakes,
    )


def figures(summary: GenerateSummary, workers: int) -> dict[str, Any]:
    """Return the figures of a run, with rates per second."""
    rate = summary.made / summary.seconds
    found = {**asdict(summary), "workers": workers, "episodes_per_s": rate}
    found["episodes_per_s_and_worker"] = rate / workers
    return {name: round(value, 3) for name, value in found.items()}


def _print_comparison(others: list[str] | None) -> None:
    """Report whether the episodes are equal to the published ones."""
    if others is None:
        return
    if not others:
        output().print("Every episode equals the published one, to the bit.")
        return
    output().print(
        f"{len(others)} episodes differ from the published ones, such as {others[0]}. "
        "They are equally valid, but this engine, C library or processor computes "
        "other last bits. See docs/determinism.md.",
        style="yellow",
    )


def _print_recovery(found: RecoveryFigures) -> None:
    """Print figures of perturbed executions."""
    mistakes = ", ".join(f"{kind} {count}" for kind, count in found.mistakes.items())
    output().print(
        f"{found.solved} of {found.episodes} episodes were solved despite "
        f"{sum(found.mistakes.values())} disturbances in {found.subtasks} sub-tasks "
        f"({mistakes}). {found.keyframes} keyframes have a label, {found.after} of "
        f"them after a disturbance; {found.unlabelled} have none and are left out.",
    )
