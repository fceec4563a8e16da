"""From parts to a LeRobotDataset: which file each episode goes to, and the joining."""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from shutil import copyfile
from typing import Any

from lemma.core.errors import DatasetError
from lemma.dataset.files import (
    MANIFEST,
    read_json,
    write_json,
    write_text,
    write_whole,
)
from lemma.dataset.lerobot.card import card
from lemma.dataset.lerobot.episode import FRAMES, Note, film_name, read_note
from lemma.dataset.lerobot.layout import (
    EXTRAS,
    INFO,
    STATS,
    SUBTASKS,
    TASKS,
    Style,
    data_path,
    info,
    video_keys,
    video_path,
)
from lemma.dataset.lerobot.tables import Placement, Sentences, Writer
from lemma.dataset.lerobot.video import join

_MB = 1024 * 1024


def name_in_recipe(path: Path) -> str:
    """Return the name of a file in the folder of its recipe."""
    return f"{path.parent.name}/{path.name}"


def assemble(
    folder: Path, style: Style, parts: Sequence[Path], files: Sequence[Path]
) -> None:
    """Put parts together, in order; what is there already is kept.

    Args:
        folder: The data set.
        style: How the episodes were filmed.
        parts: The parts, all of them.
        files: Files of the recipe that the episodes are from.

    Raises:
        DatasetError: Parts do not fit together or are damaged, or something cannot be
            written.
    """
    tasks, subtasks = Sentences(), Sentences()
    splits: dict[str, list[int]] = {}
    robots: tuple[str, ...] | None = None
    for number, part in enumerate(parts):
        note = read_note(part)
        robots = _same_team(robots, note)
        for sentence in note.instructions.values():
            tasks.number(sentence)
        for sentence in note.subtasks:
            subtasks.number(sentence)
        splits.setdefault(note.split, []).append(number)
    assert robots is not None
    placements = _place(style, parts, robots)
    writer = Writer(robots, style, tasks, subtasks)
    for number, group in _grouped(placements, attrgetter("data_file")):
        path = folder / data_path(number)
        if not path.exists():
            writer.write_frames(path, group)
    for key in video_keys(robots, style):
        for number, group in _grouped(placements, partial(_video_file, key)):
            _join_films(folder, style, key, number, group)
    writer.write_episodes(folder, placements)
    tasks.write(folder / TASKS, "task_index", "task")
    subtasks.write(folder / SUBTASKS, "subtask_index", "subtask")
    _write_json(folder / STATS, writer.total_stats(placements))
    _write_extras(folder, files)
    told = info(
        robots,
        style,
        episodes=len(parts),
        frames=sum(placement.length for placement in placements),
        tasks=len(tasks),
        splits={
            name: f"{numbers[0]}:{numbers[-1] + 1}" for name, numbers in splits.items()
        },
    )
    write_text(folder / "README.md", card(told))
    _write_json(folder / INFO, told)


def _same_team(robots: tuple[str, ...] | None, note: Note) -> tuple[str, ...]:
    if robots not in (None, tuple(note.robots)):
        raise DatasetError(
            f"{note.key} has {len(note.robots)} robots, and the episodes before it "
            "another number: they do not fit into one LeRobotDataset. Export the tasks "
            "into folders of their own, with --tasks."
        )
    return tuple(note.robots)


def _place(
    style: Style, parts: Sequence[Path], robots: tuple[str, ...]
) -> list[Placement]:
    """Decide which file every episode goes to."""
    notes = [(note.length, note.size_bytes) for note in map(read_note, parts)]
    longest = math.floor(style.video_file_s * style.fps)
    data = allot([(size[FRAMES], n) for n, size in notes], style.data_file_mb * _MB)
    videos = {
        key: allot(
            [(size[key], n) for n, size in notes], style.video_file_mb * _MB, longest
        )
        for key in video_keys(robots, style)
    }
    placements, start = [], 0
    for number, (part, (length, _)) in enumerate(zip(parts, notes, strict=True)):
        placements.append(
            Placement(
                part=part,
                number=number,
                start=start,
                length=length,
                data_file=data[number][0],
                video_files={key: places[number] for key, places in videos.items()},
            )
        )
        start += length
    return placements


def allot(
    episodes: Sequence[tuple[int, int]],
    most_bytes: float,
    most_frames: int | None = None,
) -> list[tuple[int, int]]:
    """Decide which file every episode goes to, and behind how many frames there.

    Args:
        episodes: Bytes and frames of each.
        most_bytes: Size that a file of more than one episode stays below.
        most_frames: Frames that it does not exceed.
    """
    places = []
    file = size = begin = 0
    for more, frames in episodes:
        is_full = size + more >= most_bytes or (
            most_frames is not None and begin + frames > most_frames
        )
        if begin > 0 and is_full:
            file, size, begin = file + 1, 0, 0
        places.append((file, begin))
        size, begin = size + more, begin + frames
    return places


def _video_file(key: str, placement: Placement) -> int:
    return placement.video_files[key][0]


def _grouped(
    placements: Sequence[Placement], file_of: Callable[[Placement], int]
) -> Iterator[tuple[int, list[Placement]]]:
    groups: dict[int, list[Placement]] = {}
    for placement in placements:
        groups.setdefault(file_of(placement), []).append(placement)
    yield from groups.items()


def _join_films(
    folder: Path,
    style: Style,
    key: str,
    number: int,
    group: Sequence[Placement],
) -> None:
    """Write one video, and free the room that its parts took."""
    path = folder / video_path(key, number)
    parts = [placement.part / film_name(key) for placement in group]
    if not path.exists():
        write_whole(path, partial(join, parts, style.fps))
    for part in parts:
        part.unlink(missing_ok=True)


def _write_extras(folder: Path, files: Sequence[Path]) -> None:
    """Add the recipe of the episodes: instances, and states of the physics."""
    manifest = read_json(files[0].parents[1] / MANIFEST)
    listed = {}
    for path in files:
        name = name_in_recipe(path)
        write_whole(folder / EXTRAS / name, partial(copyfile, path))
        if name in manifest["files"]:
            listed[name] = manifest["files"][name]
    write_json(folder / EXTRAS / MANIFEST, {**manifest, "files": listed})


def _write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON in the order in which it is given."""
    write_text(path, json.dumps(data, indent=4) + "\n")
