"""Teleoperated episodes as records, which are filmed like those of a recipe."""

from dataclasses import dataclass, field
from pathlib import Path

from lemma.core.errors import DatasetError
from lemma.dataset.recipe.record import EpisodeRecorder, in_words
from lemma.dataset.recipe.schema import EpisodeRecord, SubTaskRecord
from lemma.dataset.teleoperation.perform import is_same, perform
from lemma.dataset.teleoperation.schema import (
    LED,
    Commanded,
    Executed,
    Teleoperation,
    is_teleoperated,
)
from lemma.env.episode import Episode

_NOWHERE = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class TeleoperatedRecord(EpisodeRecord):
    """An episode with steps that are no sub-tasks; see ``done``."""

    done: Teleoperation = field(repr=False)
    """All steps."""


def files_in(place: Path) -> list[Path]:
    """Return the files of teleoperated episodes: one, or those of a folder.

    Args:
        place: A file or a folder; other files there are ignored.
    """
    found = [place] if place.is_file() else sorted(place.glob("*.json"))
    return [path for path in found if is_teleoperated(path)]


def read_record(path: Path) -> TeleoperatedRecord:
    """Read a file, and play it again to get its states.

    Raises:
        DatasetError: It leads to another state here.
        LemmaError: It cannot be read, or a step is impossible.
    """
    done = Teleoperation.load(path)
    episode = Episode(done.instance)
    keeper, times = EpisodeRecorder(episode), []

    def keep(number: int) -> None:
        keeper.keep()
        times.append(episode.simulation.time_s)

    perform(done, episode, keep)
    if not is_same(done, episode):
        raise DatasetError(
            f"{path}: what was done leads to another state here. Read it with the "
            "versions, and on the kind of machine, that it was written with."
        )
    ends = (*times[1:-1], done.end_s)
    rows = (
        _row(done, part, end_s) for part, end_s in zip(done.parts, ends, strict=True)
    )
    columns = keeper.columns() | {
        "key": f"{done.instance.key}/{path.stem}",
        "high_level": done.instruction,
        "subtasks": tuple(rows),
        "keyframe_time_s": tuple(times),
    }
    return TeleoperatedRecord(**columns, done=done)


def _row(
    done: Teleoperation, part: Executed | Commanded, end_s: float
) -> SubTaskRecord:
    took_s = end_s - part.start_s
    if isinstance(part, Commanded):
        nobody = ("", "", "", "", f"{LED}.", _NOWHERE, _NOWHERE)
        return SubTaskRecord(*nobody, "by_hand", part.start_s, took_s)
    subtask, pick, place = part.subtask, part.grounded.pick, part.grounded.place
    return SubTaskRecord(
        robot=subtask.robot,
        primitive=str(subtask.primitive),
        pick=subtask.pick,
        place=subtask.place,
        instruction=in_words(done.instance, subtask),
        pick_pose=(pick.x, pick.y, pick.yaw),
        place_pose=(place.x, place.y, place.yaw),
        outcome="" if part.until_s is None else "taken_over",
        start_s=part.start_s,
        duration_s=took_s,
    )
