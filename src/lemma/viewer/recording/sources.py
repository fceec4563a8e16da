"""Replays of a folder: the episodes of a recipe, or of results."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.workers.pool import Engine
from lemma.dataset.recipe.files import Recipe, load
from lemma.dataset.teleoperation import Teleoperation, is_teleoperated
from lemma.evaluation.report.episodes import Case, cases_of
from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.viewer.recording.pages import client_page, replay_of
from lemma.viewer.recording.replays import (
    expert_instead,
    replay_line,
    replay_record,
    replay_teleoperation,
)
from lemma.viz.pages.replays import Replay, write_replays


def replays_in(
    folder: Path, task: str | None, split: str | None, limit: int
) -> tuple[int, Iterator[Replay]]:
    """Find episodes.

    Args:
        folder: A recipe, a result of ``lemma evaluate``, or the file of an episode
            that was led by hand.
        task: Only those of this task.
        split: Only those of this split.
        limit: Largest number.

    Returns:
        Their number, and each of them as soon as it was played again.

    Raises:
        InvalidConfigError: There are none.
        DatasetError: It holds neither, or is damaged.
    """
    found: Sequence[Callable[[], Replay]]
    if is_teleoperated(folder):
        found = [partial(_of_teleoperation, Teleoperation.load(folder), folder.stem)]
    elif any(folder.glob("*/*.parquet")):
        recipe = load(folder).select(task=task, split=split)[:limit]
        found = [partial(_of_record, recipe, number) for number in range(len(recipe))]
    else:
        cases = [
            case
            for case in cases_in(folder)
            if case.is_repeatable
            and task in (None, case.row["task"])
            and split in (None, case.row["split"])
        ]
        found = [partial(replay_of_case, case) for case in cases[:limit]]
    if not found:
        raise InvalidConfigError(
            f"{folder} has no episodes of task {task or 'any'} and split "
            f"{split or 'any'} that can be played again."
        )
    return len(found), (make() for make in found)


def cases_in(folder: Path) -> list[Case]:
    """Return the episodes of results, those that failed first.

    Raises:
        DatasetError: There are no results, or they are damaged.
    """
    results = read_results([folder])
    if not results:
        raise DatasetError(
            f"There is neither a recipe nor a result in {folder}. Name what 'lemma "
            "generate' or 'lemma evaluate' wrote."
        )
    cases, _ = cases_of(entries_of(results, complete=False), [folder])
    return sorted(cases, key=lambda case: case.cause is None)


def write_cases(
    cases: Sequence[tuple[int, Case]],
    folder: Path,
    engine: Engine,
    advance: Callable[[int], None],
) -> dict[int, str]:
    """Write a page for each episode; all share one player.

    Args:
        cases: Number and episode of each.
        folder: Where; made if it is missing.
        engine: Where to work.
        advance: Called with the number of episodes that were done since the last call.

    Returns:
        Names of the files in that folder, by number.
    """
    player, written = client_page(), {}
    for number, replay in engine.run(_numbered, list(cases)):
        written[number] = f"{number}-{replay.name}.html"
        write_replays(folder / written[number], [replay], player, shared=True)
        advance(1)
    return written


def _numbered(number: int, case: Case) -> tuple[int, Replay]:
    return number, replay_of_case(case)


def replay_of_case(case: Case, other: Case | None = None) -> Replay:
    """Return an episode of a result beside another.

    Args:
        case: The episode.
        other: The other one; if None, the expert goes on from a mistake.

    Raises:
        LemmaError: It cannot be played again.
    """
    again = replay_line(case)
    sides, differs = [again.recording], [again.differs]
    if other is not None:
        beside = replay_line(other)
        sides.append(beside.recording)
        differs.append(beside.differs)
    elif case.cause is not None:
        sides.append(expert_instead(case, again))
    row = case.row
    return replay_of(
        f"{row['instruction_kind']}-{row['task']}-{row['index']}",
        f"{row['task']} {row['index']}, {case.policy}",
        sides,
        sentence=row["instruction"],
        opens_s=0.0 if case.cause is None else again.turn_s,
        note=" ".join(f"It went differently here. {text}" for text in differs if text),
    )


def _of_teleoperation(done: Teleoperation, name: str) -> Replay:
    recording, same = replay_teleoperation(done)
    note = "" if same else "It went differently here."
    title = f"{done.instance.task} {done.instance.index}, by hand"
    return replay_of(name, title, [recording], sentence=done.instruction, note=note)


def _of_record(recipe: Recipe, number: int) -> Replay:
    record = recipe[number]
    name = f"{record.task}-{record.split}-{record.index}"
    title = f"{record.task} {record.index} ({record.split})"
    return replay_of(name, title, [replay_record(record)])
