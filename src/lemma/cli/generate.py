"""`lemma generate`: the expert's demonstrations of the suite, as a recipe."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from lemma.cli.options import JsonFlag, Number, Word, output, print_json, words
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import InvalidConfigError
from lemma.dataset.recipe.digests import differing
from lemma.dataset.recipe.generate import GenerateConfig, GenerateSummary
from lemma.dataset.recipe.generate import generate as write_recipe
from lemma.dataset.recipe.reader import load
from lemma.dataset.recipe.recovery import RecoveryFigures, recovery_figures
from lemma.expert.disturbances import Perturbation
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.suite import FREE_SPLIT, SUITE, has_frozen_lists

_AT_INTERRUPT = (
    "{done} of {total} episodes are written. The same command goes on from there."
)
_ALL = "all"
_RECIPE = Path(f"data/lemma-{BENCHMARK_VERSION}")
_RECOVERY = Path(f"data/lemma-{BENCHMARK_VERSION}-recovery")


@dataclass(frozen=True, slots=True)
class GenerateOptions:
    """Which episodes, and whether their sub-tasks go wrong to show what to do then."""

    tasks: Annotated[str, tyro.conf.arg(metavar="TASK,...")] = _ALL
    """Names of tasks, separated by commas."""
    split: Annotated[Word, tyro.conf.arg(metavar="SPLIT,...")] = None
    """Names of splits, separated by commas; all frozen ones by default, train with
    --perturb, free for tasks of your own. Split free needs --episodes."""
    episodes: Number = None
    """Only the first so many of every task and split; all by default."""
    perturb: Annotated[
        float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")
    ] = None
    """Make recovery states instead of demonstrations: each sub-task goes wrong with
    this probability, such as 0.3, and the expert's decision is recorded too."""
    perturb_seed: int = 0
    """With --perturb: another seed makes other mistakes in the same instances."""

    def order(self, out: Path | None) -> GenerateConfig:
        """Return the settings, with the folder.

        Raises:
            InvalidConfigError: A seed has no use.
            LemmaError: A name is unknown.
        """
        perturb = None
        if self.perturb is not None:
            perturb = Perturbation(self.perturb, self.perturb_seed)
        elif self.perturb_seed:
            raise InvalidConfigError(
                "--perturb-seed draws mistakes, but none are made. Add --perturb 0.3."
            )
        tasks = SUITE if self.tasks == _ALL else words(self.tasks)
        frozen = ("train",) if perturb else tuple(SPLITS)
        splits = frozen if all(map(has_frozen_lists, tasks)) else (FREE_SPLIT,)
        return GenerateConfig(
            out=out or (_RECOVERY if perturb else _RECIPE),
            tasks=tasks,
            splits=words(self.split) if self.split else splits,
            episodes=self.episodes,
            perturb=perturb,
        )


_EVERYTHING = GenerateOptions()


def generate(
    wanted: Annotated[GenerateOptions, tyro.conf.arg(name="")] = _EVERYTHING,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")
    ] = None,
    working: WorkerOptions = DEFAULT,
    resume: bool = True,
    as_json: JsonFlag = False,
) -> int:
    """Let the expert solve the frozen instances, and write what it did.

    Files that exist are kept, so the same command continues an interrupted run.

    Args:
        wanted: Which episodes.
        out: Folder of the recipe; data/lemma-v2 by default, and
            data/lemma-v2-recovery with --perturb.
        working: Options of the workers.
        resume: Complete an existing folder; otherwise it must be empty.
        as_json: Print one JSON object instead of a table.
    """
    order = wanted.order(out)
    out = order.out
    if not resume and out.is_dir() and any(out.iterdir()):
        raise InvalidConfigError(
            f"{out} is not empty. Leave out --no-resume to complete what is there, or "
            "choose another folder; nothing is ever deleted."
        )
    engine = working.make_engine()
    with progress_bar("generate", order.total, _AT_INTERRUPT) as advance:
        summary = write_recipe(order, engine, advance)
    found: dict[str, Any] = dict(figures(summary, engine.workers))
    if not as_json:
        _print(out, found)
    if order.perturb:
        recovery = recovery_figures(load(out))
        if as_json:
            print_json(found | {"recovery": recovery.to_dict()})
        else:
            _print_recovery(recovery)
    elif as_json:
        print_json(found | {"differing": differing(out)})
    else:
        _print_comparison(differing(out))
    return 0


def figures(summary: GenerateSummary, workers: int) -> dict[str, float]:
    """Return the outcome of a run, with rates."""
    rate = summary.made / summary.seconds
    found = {**asdict(summary), "workers": workers, "episodes_per_s": rate}
    found["episodes_per_s_and_worker"] = rate / workers
    return {name: round(value, 3) for name, value in found.items()}


def _print_comparison(others: list[str] | None) -> None:
    """Say whether the episodes are equal to the published ones."""
    if others is None:
        return
    if not others:
        output().print("Every episode equals the published one, to the bit.")
        return
    output().print(
        f"{len(others)} episodes are not what the authors' machine made, such as "
        f"{others[0]}. They are as good; but this engine, C library or processor "
        "computes other last bits. See docs/determinism.md.",
        style="yellow",
    )


def _print_recovery(found: RecoveryFigures) -> None:
    """Print figures of perturbed executions."""
    mistakes = ", ".join(f"{kind} {count}" for kind, count in found.mistakes.items())
    output().print(
        f"{found.solved} of {found.episodes} episodes were solved in spite of "
        f"{sum(found.mistakes.values())} mistakes in {found.subtasks} sub-tasks "
        f"({mistakes}). {found.keyframes} keyframes have a label, {found.after} of "
        f"them after a mistake; {found.unlabelled} have none and are left out.",
    )


_WORDS = {
    "episodes": ("episodes", "{:.0f}"),
    "made": ("made by this run", "{:.0f}"),
    "seconds": ("seconds", "{:.1f}"),
    "workers": ("workers", "{:.0f}"),
    "episodes_per_s": ("episodes per second", "{:.2f}"),
    "episodes_per_s_and_worker": ("the same per worker", "{:.2f}"),
    "size_mb": ("size on disk", "{:.1f} MB"),
    "worker_mb": ("peak memory of a worker", "{:.0f} MB"),
}


def _print(out: Path, found: dict[str, float]) -> None:
    table = Table(title=str(out), title_justify="left", show_header=False)
    table.add_column()
    table.add_column(justify="right", style="bold")
    for name, (label, form) in _WORDS.items():
        if found["made"] or name in ("episodes", "made", "size_mb"):
            table.add_row(label, form.format(found[name]))
    output().print(table)
