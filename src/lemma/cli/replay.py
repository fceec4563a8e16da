"""`lemma replay`: play episodes again, and compare their states bit by bit."""

from dataclasses import asdict
from pathlib import Path
from shlex import quote
from time import perf_counter
from typing import Any

from lemma.cli.options import (
    Data,
    Flag,
    Folder,
    JsonFlag,
    Number,
    Word,
    output,
    print_json,
    print_table,
)
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import InvalidConfigError
from lemma.dataset.recipe.files import Recipe, load
from lemma.dataset.recipe.replay import Replay, replay_all
from lemma.dataset.teleoperation import Teleoperation, is_same, is_teleoperated, perform
from lemma.env.episode import Episode

_AT_INTERRUPT = (
    "{done} of {total} episodes were compared; the comparison is not saved, and no "
    "file was changed."
)
_SHOWN = 20
_IN_A_PAGE = 8
_WHY = (
    "States depend on the engine, the processor family and the C library's "
    "mathematics. Replay on the kind of machine that wrote them."
)


def replay(
    data: Data,
    task: Word = None,
    split: Word = None,
    limit: Number = None,
    working: WorkerOptions = DEFAULT,
    browser: Folder = None,
    validate: Flag = False,
    as_json: JsonFlag = False,
) -> int:
    """Play a recipe again, and report states that are not reproduced.

    It also plays an episode that was led by hand on the page of lemma play. With
    --browser, it writes a page with interactive replays: of a recipe, of an episode
    led by hand, or of a result of lemma evaluate beside the expert's solution.

    Args:
        data: Folder of the recipe, or file of an episode that was led by hand.
        task: Only the episodes of this task.
        split: Only the episodes of this split.
        limit: Largest number of episodes; with --browser 8 by default.
        working: Options of the workers.
        browser: Folder for a page that needs neither a server nor a network, and a
            .viser file of each episode.
        validate: No effect: every replay validates.
        as_json: Print one JSON object instead of text.
    """
    if limit is not None and limit < 1:
        raise InvalidConfigError(f"--limit is 1 or more, not {limit}.")
    by_hand = is_teleoperated(data)
    if by_hand and (task, split, limit) != (None, None, None):
        raise InvalidConfigError(
            f"{data} is a single episode that was led by hand. Leave out --task, "
            "--split and --limit."
        )
    if browser is not None:
        return _show(data, browser, task, split, limit or _IN_A_PAGE)
    if by_hand:
        return _again(data, as_json=as_json)
    recipe = choose(load(data), task, split, limit)
    engine = working.make_engine()
    start = perf_counter()
    with progress_bar("replay", len(recipe), _AT_INTERRUPT) as advance:
        drifting = replay_all(recipe, engine, advance)
    seconds = perf_counter() - start
    if as_json:
        print_json(_report(len(recipe), drifting, seconds))
    else:
        _print(len(recipe), drifting, seconds)
    return 1 if drifting else 0


def _show(data: Path, out: Path, task: str | None, split: str | None, most: int) -> int:
    from lemma.viewer.replays import replays_in, write_folder

    count, replays = replays_in(data, task, split, most)
    done = []
    with progress_bar("replay", count, "no page was written.") as advance:
        for one in replays:
            done.append(one)
            advance(1)
    page = write_folder(out, done)
    output().print(f"Episodes: {count}. Page: {page}", soft_wrap=True)
    return 0


def _again(file: Path, *, as_json: bool) -> int:
    """Play an episode again that was led by hand.

    Raises:
        InvalidConfigError: A step cannot be executed.
    """
    done = Teleoperation.load(file)
    start = perf_counter()
    episode = Episode(done.instance)
    perform(done, episode)
    same = is_same(done, episode)
    seconds = perf_counter() - start
    if as_json:
        print_json({"episodes": 1, "same": same, "seconds": round(seconds, 3)})
    elif same:
        output().print(
            f"The {done.end_s:.1f} s are reproduced to the bit ({seconds:.1f} s).",
            style="green",
        )
    else:
        output().print("The final state differs.", style="bold red")
        output().print(_WHY)
    return 0 if same else 1


def choose(
    recipe: Recipe, task: str | None, split: str | None, limit: int | None = None
) -> Recipe:
    """Return a recipe with the selected episodes.

    Raises:
        InvalidConfigError: No episode is selected.
    """
    chosen = recipe.select(task=task, split=split)[:limit]
    if not len(chosen):
        raise InvalidConfigError(
            f"{recipe.folder} has no episodes of task {task or 'any'} and split "
            f"{split or 'any'}. 'lemma inspect "
            f"{quote(str(recipe.folder))}' lists its content."
        )
    return chosen


def _report(episodes: int, drifting: list[Replay], seconds: float) -> dict[str, Any]:
    return {
        "episodes": episodes,
        "drifting": [asdict(found) for found in drifting],
        "seconds": round(seconds, 3),
        "episodes_per_s": round(episodes / seconds, 3),
    }


def _print(episodes: int, drifting: list[Replay], seconds: float) -> None:
    console = output()
    if not drifting:
        console.print(
            f"All {episodes} episodes are reproduced to the bit ({seconds:.1f} s).",
            style="green",
        )
        return
    console.print(f"{len(drifting)} of {episodes} episodes drift.", style="bold red")
    rows = [(one.key, one.drift_at, f"{one.worst:.3g}") for one in drifting[:_SHOWN]]
    print_table(("episode", "first at keyframe", "largest difference"), rows)
    if len(drifting) > _SHOWN:
        console.print(f"... and {len(drifting) - _SHOWN} more; --json lists them all.")
    console.print(_WHY)
