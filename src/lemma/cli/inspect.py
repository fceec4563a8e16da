"""`lemma inspect`: what is in a recipe; one episode of it as pictures."""

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from lemma.cli.options import File, JsonFlag, Number, Word, messages, output, print_json
from lemma.cli.replay import Folder, choose
from lemma.core.errors import InvalidConfigError
from lemma.dataset.recipe.balance import ALL
from lemma.dataset.recipe.files import open_table
from lemma.dataset.recipe.reader import Recipe, load
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.recipe.statistics import Statistics, statistics_of
from lemma.viz.keyframe_sheet import keyframe_strip
from lemma.viz.pages.dataset import (
    p_words,
    table_cells,
    verdict_words,
    write_dataset_page,
)

_SPLIT = "test"


def inspect(
    data: Folder,
    task: Word = None,
    split: Word = None,
    index: Number = None,
    out: File = None,
    as_json: JsonFlag = False,
) -> int:
    """Say what is in a recipe; with --task and --index, draw one episode.

    Args:
        data: Folder of the recipe.
        task: Only this task.
        split: Only this split; for one episode, test by default.
        index: Draw the episode of this number.
        out: The page with plots (HTML), or the picture of the episode (PNG); in
            out/inspect by default.
        as_json: Print one JSON object instead of tables, and write no page.
    """
    recipe = load(data)
    if index is not None:
        return _inspect_episode(recipe, task, split or _SPLIT, index, out)
    chosen = choose(recipe, task, split)
    with messages().status(f"Reading {len(chosen)} episodes ..."):
        found = statistics_of(chosen)
    versions = open_table(chosen.files()[0])[1]
    if as_json:
        print_json({"versions": versions, **found.to_dict()})
        return 0
    path = out or Path("out", "inspect", f"{data.resolve().name}.html")
    size_mb = sum(file.stat().st_size for file in chosen.files()) / 1e6
    write_dataset_page(path, data.resolve().name, found, versions, size_mb)
    _print(found, size_mb)
    output().print(f"page       {path}", style="bold", soft_wrap=True)
    return 0


def _inspect_episode(
    recipe: Recipe, task: str | None, split: str, index: int, out: Path | None
) -> int:
    if task is None:
        raise InvalidConfigError(
            "--index names an episode of one task. Say which with --task."
        )
    record = recipe.find(task, split, index)
    path = out or Path("out", "inspect", f"{task}-{split}-{index}.png")
    with messages().status(f"Drawing {record.keyframes} keyframes ..."):
        picture = keyframe_strip(record)
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(path)
    _print_episode(record)
    output().print(f"picture    {path}", style="bold", soft_wrap=True)
    return 0


def _print_episode(record: EpisodeRecord) -> None:
    console = output()
    ending = "solved" if record.success else f"not solved: {record.failure}"
    for name, text in (
        ("episode", record.key),
        *((kind, getattr(record, kind)) for kind in ("high_level", "human", "unseen")),
        ("team", f"{record.team}, {record.distractors} distractors"),
        ("outcome", f"{ending} after {record.elapsed_s:.1f} simulated s"),
    ):
        console.print(f"{name:<11}{text}", soft_wrap=True)
    table = Table()
    for heading in ("", "start", "takes", "sub-task", "outcome"):
        table.add_column(heading)
    for number, row in enumerate(record.subtasks, 1):
        times = (f"{row.start_s:.1f} s", f"{row.duration_s:.1f} s")
        table.add_row(str(number), *times, row.instruction, row.outcome)
    console.print(table)


def _print(found: Statistics, size_mb: float) -> None:
    console = output()
    console.print(_groups_table(found))
    console.print(_balance_table(found))
    even = found.evenness.even
    console.print(verdict_words(found.evenness), style=None if even else "bold red")
    rejected = (
        f"{task} {rates.sampler_rate:.1%}" for task, rates in found.rejections.items()
    )
    refused = sum(rates.by_expert for rates in found.rejections.values())
    console.print()
    if found.rejections:
        console.print(f"rejected   tables, by the sampler: {', '.join(rejected)}")
        console.print(f"           instances, by the expert: {refused}")
    console.print(f"size       {size_mb:.1f} MB")


def _groups_table(found: Statistics) -> Table:
    """Return the numbers by task, by split, by team, and of all."""
    # Eighty columns are enough without padding.
    table = Table(box=SIMPLE_HEAD, padding=0, pad_edge=False)
    for heading in ("", *table_cells(found.total)):
        table.add_column(heading, justify="right" if heading else "left")
    groups = [found.tasks, found.splits, found.teams]
    for group in (group for group in groups if len(group) > 1):
        for name, summary in group.items():
            table.add_row(name, *table_cells(summary).values())
        table.add_section()
    table.add_row(ALL, *table_cells(found.total).values(), style="bold")
    return table


def _balance_table(found: Statistics) -> Table:
    """Return how often everything was drawn, over all tasks."""
    table = Table(box=SIMPLE_HEAD, padding=0, pad_edge=False)
    for heading in ("drawn evenly?", "counts", "p"):
        table.add_column(heading, justify="right" if heading == "p" else "left")
    for name, balances in found.balances.items():
        counts = (f"{value} {count}" for value, count in balances[ALL].counts.items())
        table.add_row(name, ", ".join(counts), p_words(balances[ALL]))
    return table
