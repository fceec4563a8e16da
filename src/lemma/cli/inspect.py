"""`lemma inspect`: a summary of a recipe, or pictures of one of its episodes."""

from dataclasses import asdict
from pathlib import Path

from lemma.cli.options import (
    Data,
    File,
    JsonFlag,
    Number,
    Word,
    messages,
    print_json,
    print_named,
    print_table,
)
from lemma.cli.replay import choose
from lemma.core.errors import InvalidConfigError
from lemma.dataset.recipe.files import Recipe, load, open_table
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.recipe.summary import ALL, GroupSummary, RecipeSummary, summarize
from lemma.tasks.language.template import KINDS
from lemma.viz.sheets import check_picture_path, keyframe_strip, save_picture

_SPLIT = "test"
_HEADINGS = (
    *("", "episodes", "solved", "sub-tasks", "objects", "distractors"),
    *("time", "margin"),
)


def inspect(
    data: Data,
    task: Word = None,
    split: Word = None,
    index: Number = None,
    out: File = None,
    as_json: JsonFlag = False,
) -> int:
    """Summarize a recipe; with --task and --index, draw one episode.

    Args:
        data: Folder of the recipe.
        task: Only this task.
        split: Only this split; for one episode, test by default.
        index: Index of the episode to draw.
        out: The picture of the episode (PNG); in out/inspect by default.
        as_json: Print one JSON object instead of a table.
    """
    recipe = load(data)
    if index is not None:
        return _inspect_episode(recipe, task, split or _SPLIT, index, out)
    chosen = choose(recipe, task, split)
    with messages().status(f"Reading {len(chosen)} episodes ..."):
        found = summarize(chosen)
    versions = open_table(chosen.files()[0])[1]
    if as_json:
        print_json({"versions": versions, **asdict(found)})
        return 0
    size_mb = sum(file.stat().st_size for file in chosen.files()) / 1e6
    _print(found, size_mb)
    return 0


def _inspect_episode(
    recipe: Recipe, task: str | None, split: str, index: int, out: Path | None
) -> int:
    if task is None:
        raise InvalidConfigError("--index needs a task. Name it with --task.")
    record = recipe.find(task, split, index)
    path = out or Path("out", "inspect", f"{task}-{split}-{index}.png")
    check_picture_path(path)
    with messages().status(f"Drawing {record.keyframes} keyframes ..."):
        picture = keyframe_strip(record)
    save_picture(picture, path)
    _print_episode(record)
    print_named(("picture", path), style="bold")
    return 0


def _print_episode(record: EpisodeRecord) -> None:
    ending = "solved" if record.success else f"not solved: {record.failure}"
    print_named(
        ("episode", record.key),
        *((kind, getattr(record, kind)) for kind in KINDS),
        ("team", f"{record.team}, {record.distractors} distractors"),
        ("outcome", f"{ending} after {record.elapsed_s:.1f} simulated s"),
    )
    rows = (
        (n, row.instruction, row.outcome, f"{row.start_s:.1f}", f"{row.duration_s:.1f}")
        for n, row in enumerate(record.subtasks, 1)
    )
    print_table(("", "sub-task", "outcome", "start [s]", "takes [s]"), rows, labels=3)


def _print(found: RecipeSummary, size_mb: float) -> None:
    """Print the numbers by task, by split, by team, and in total."""
    groups = [g for g in (found.tasks, found.splits, found.teams) if len(g) > 1]
    rows = [(name, *_cells(one)) for group in groups for name, one in group.items()]
    rows.append((ALL, *_cells(found.total)))
    print_table(_HEADINGS, rows, bold=[len(rows) - 1])
    means = (f"{name} {s.mean:.1f} s" for name, s in found.primitives_s.items())
    print_named(("sub-tasks", ", ".join(means)), ("size", f"{size_mb:.1f} MB"))


def _cells(group: GroupSummary) -> tuple[str, ...]:
    """Return the numbers of a group as text."""
    objects, more = group.objects, group.distractors
    return (
        f"{group.episodes}",
        f"{group.solved / group.episodes:.0%}",
        f"{group.subtasks.mean:.2f}",
        f"{objects.least:.0f}–{objects.most:.0f}",
        f"{more.least:.0f}–{more.most:.0f}",
        f"{group.elapsed_s.mean:.1f} s",
        f"{100 * group.margin_m.least:.1f} cm",
    )
