"""Jobs that the same command continues after they were stopped.

A job writes into a folder. Its record, the settings and versions that decide what is
written, lies in the folder too: a job with another record is refused. The parts of a
job are written whole or not at all, so a part that exists is done. One process at a
time writes, see :func:`lemma.core.files.only_writer`.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lemma.core.errors import DatasetError, shown
from lemma.core.files import read_json, write_json
from lemma.core.workers.pool import Engine, Job, Listener, ignore, numbered

PARTS = ".parts"
"""Folder, in that of a job, of parts that become larger files when all are there."""
RECORD = f"{PARTS}/about.json"
"""Where the record of a job is that deletes it at its end."""
MAY_DIFFER = ("revision", "versions.revision")
"""Entries of a record that say where a job ran, and decide nothing."""
NEW_FOLDER = "Choose a new folder, or delete this one."

_NAMED = 5
"""Differences that a message names."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a job."""

    arguments: Job
    """Arguments of the function that does it."""
    size: int
    """How many episodes it counts for."""
    is_done: bool


def do_missing(
    parts: Sequence[Part],
    function: Callable[..., Any],
    engine: Engine,
    advance: Callable[[int], None],
    on_report: Listener = ignore,
) -> Iterator[tuple[Part, Any]]:
    """Do the parts that are not done, and yield each with what was returned for it.

    Args:
        parts: All parts of the job.
        function: Function that does a part; it belongs to a module.
        engine: Workers that run the jobs.
        advance: Called at once with the number of episodes that are done already.
        on_report: Called with each report of a part before that ends.
    """
    advance(sum(part.size for part in parts if part.is_done))
    missing = [part for part in parts if not part.is_done]
    jobs = [(number, function, part.arguments) for number, part in enumerate(missing)]
    for number, result in engine.run(numbered, jobs, on_report):
        yield missing[number], result


def begin(folder: Path, name: str, record: Mapping[str, Any]) -> None:
    """Write the record of a job, or check that the job of this record is continued.

    A job that was stopped before its first part was done may be begun otherwise.

    Args:
        folder: Of the job.
        name: Of the file with the record, relative to the folder.
        record: Settings and versions.

    Raises:
        DatasetError: Another job was begun there, or the record cannot be written.
    """
    path = folder / name
    found = read_json(path) if path.exists() else None
    if found is not None and has_parts(folder, name):
        check_same_job(path, found, record)
    else:
        write_json(path, dict(record))


def has_parts(folder: Path, name: str) -> bool:
    """Return whether the folder of a job holds more than its record.

    Empty files, such as locks, do not count.

    Args:
        folder: Of the job.
        name: Of the file with the record, relative to the folder.
    """
    return any(
        file != folder / name and file.is_file() and file.stat().st_size > 0
        for file in folder.rglob("*")
    )


def check_same_job(
    place: Path,
    found: Mapping[str, Any],
    record: Mapping[str, Any],
    *,
    may_differ: Collection[str] = MAY_DIFFER,
    advice: str = NEW_FOLDER,
) -> None:
    """Check that what is there was written by the job that would write it now.

    Args:
        place: A file or a folder.
        found: The record that it holds.
        record: The record of the job that is asked for.
        may_differ: Dotted names of entries that are not compared.
        advice: A sentence that says what to do.

    Raises:
        DatasetError: The records differ, and in what.
    """
    differing = differences(found, record, may_differ)
    if differing:
        raise DatasetError(
            f"{place} holds another run: {'; '.join(differing[:_NAMED])}. {advice}"
        )


def differences(
    found: Mapping[str, Any],
    record: Mapping[str, Any],
    may_differ: Collection[str] = MAY_DIFFER,
) -> list[str]:
    """Return in words what differs between two records.

    Args:
        found: The earlier one.
        record: The later one.
        may_differ: Dotted names of entries that are not compared.
    """
    before, now = dict(flat(found)), dict(flat(record))
    return [
        f"{name} was {_word(before.get(name))} and is now {_word(now.get(name))}"
        for name in sorted({*before, *now}.difference(may_differ))
        if before.get(name) != now.get(name)
    ]


def flat(record: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and the values of a nested record, lists as JSON has."""
    for name, value in record.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", list(value) if isinstance(value, tuple) else value


def _word(value: Any) -> str:
    if value is None:
        return "not given"
    return value if isinstance(value, str) and value else shown(value)
