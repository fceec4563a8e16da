"""`lemma generate`: the expert's demonstrations of the suite, as a recipe."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from lemma.cli.terminal import JsonFlag, Number, complain, output, print_json
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import InvalidConfigError
from lemma.dataset.digests import differing
from lemma.dataset.generate import Order, Summary
from lemma.dataset.generate import generate as write_recipe
from lemma.tasks.suite import SUITE

INTERRUPTED = 130
_ALL = "all"


def generate(
    tasks: Annotated[str, tyro.conf.arg(metavar="TASK,...")] = _ALL,
    split: Annotated[str, tyro.conf.arg(metavar="SPLIT,...")] = "train,val,test",
    out: Path = Path("data/lemma-v1"),
    episodes: Number = None,
    working: WorkerOptions = DEFAULT,
    resume: bool = True,
    as_json: JsonFlag = False,
) -> int:
    """Let the expert solve the frozen instances, and write what it did.

    What is there already is kept, so the same command goes on where it was stopped.

    Args:
        tasks: Names of tasks, separated by commas.
        split: Names of splits, separated by commas.
        out: Folder of the recipe.
        episodes: Only the first so many of every task and split; all by default.
        working: Where to work.
        resume: Complete what is there; otherwise the folder must be empty.
        as_json: Print one JSON object instead of a table.
    """
    order = Order(
        out=out,
        tasks=SUITE if tasks == _ALL else words(tasks),
        splits=words(split),
        episodes=episodes,
    )
    if not resume and out.is_dir() and any(out.iterdir()):
        raise InvalidConfigError(
            f"{out} is not empty. Leave out --no-resume to complete what is there, or "
            "choose another folder; nothing is ever deleted."
        )
    engine = working.make_engine()
    done = 0
    try:
        with progress_bar("generate", order.total) as advance:

            def count(more: int) -> None:
                nonlocal done
                done += more
                advance(more)

            summary = write_recipe(order, engine, count)
    except KeyboardInterrupt:
        complain(
            f"Interrupted with {done} of {order.total} episodes written. The same "
            "command goes on from there."
        )
        return INTERRUPTED
    if as_json:
        print_json(figures(summary, engine.workers) | {"differing": differing(out)})
    else:
        _print(out, figures(summary, engine.workers))
        _print_comparison(differing(out))
    return 0


def words(listed: str) -> tuple[str, ...]:
    """Return the words of a list separated by commas, each once.

    Raises:
        InvalidConfigError: There is none.
    """
    found = tuple(dict.fromkeys(w.strip() for w in listed.split(",") if w.strip()))
    if not found:
        raise InvalidConfigError(
            f"{listed!r} names nothing. Separate names by commas: train,val."
        )
    return found


def figures(summary: Summary, workers: int) -> dict[str, float]:
    """Return what a run came to, with rates."""
    rate = summary.made / summary.seconds
    found = {**asdict(summary), "workers": workers, "episodes_per_s": rate}
    found["episodes_per_s_and_worker"] = rate / workers
    return {name: round(value, 3) for name, value in found.items()}


def _print_comparison(others: list[str]) -> None:
    """Say whether the folder holds what the authors' machine made."""
    if not others:
        output().print("Every episode equals the published one, to the bit.")
        return
    output().print(
        f"{len(others)} episodes are not what the authors' machine made, such as "
        f"{others[0]}. They are as good; but this engine, C library or processor "
        "computes other last bits. See docs/determinism.md.",
        style="yellow",
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
