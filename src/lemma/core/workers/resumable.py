"""Jobs that the same command resumes after they were stopped.

A job writes to a folder. The folder also has the job's record, the settings and
versions that determine the output; a job with another record is refused. Parts of a job
are written atomically, so a part that exists is complete. One process at a time writes,
see :func:`lemma.core.files.only_writer`.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lemma.core.errors import DatasetError, shown
from lemma.core.files import read_json, write_json
from lemma.core.workers.pool import Engine, Job, Listener, ignore, numbered

PARTS = ".parts"
"""Subfolder for parts that are merged into larger files when all are complete."""
RECORD = f"{PARTS}/about.json"
"""Path of the record in jobs that delete it at their end."""
MAY_DIFFER = ("revision", "versions.revision")
"""Entries of a record that do not affect the output."""
NEW_FOLDER = "Choose a new folder, or delete this one."

_NAMED = 5
"""Largest number of differences in a message."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a job."""

    arguments: Job
    """Arguments of the function that writes it."""
    size: int
    """Number of its episodes, for progress."""
    is_done: bool


def do_missing(
    parts: Sequence[Part],
    function: Callable[..., Any],
    engine: Engine,
    advance: Callable[[int], None],
    on_report: Listener = ignore,
) -> Iterator[tuple[Part, Any]]:
    """Write the missing parts of a job; yield each with its return value.

    Args:
        parts: All parts of the job.
        function: Function that writes a part, at the top level of a module.
        engine: Workers that run the jobs.
        advance: Called first, with the number of episodes that are complete already.
        on_report: Called with each report of a part before the part has ended.
    """
    advance(sum(part.size for part in parts if part.is_done))
    missing = [part for part in parts if not part.is_done]
    jobs = [(number, function, part.arguments) for number, part in enumerate(missing)]
    for number, result in engine.run(numbered, jobs, on_report):
        yield missing[number], result


def begin(folder: Path, name: str, record: Mapping[str, Any]) -> None:
    """Write the record of a job, or check that it is equal to the existing one.

    If the folder has no complete part yet, another record replaces the existing one.

    Args:
        folder: Folder of the job.
        name: File of the record, relative to the folder.
        record: Settings and versions.

    Raises:
        DatasetError: The folder belongs to another job, or the record cannot be
            written.
    """
    path = folder / name
    found = read_json(path) if path.exists() else None
    if found is not None and has_parts(folder, name):
        check_same_job(path, found, record)
    else:
        write_json(path, dict(record))


def has_parts(folder: Path, name: str) -> bool:
    """Return whether the folder of a job contains more than its record.

    Empty files, such as locks, do not count.

    Args:
        folder: Folder of the job.
        name: File of the record, relative to the folder.
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
    """Check that existing output belongs to the present job.

    Args:
        place: The file or folder of the output.
        found: The record in the output.
        record: The record of the present job.
        may_differ: Dotted names of entries that are not compared.
        advice: A sentence of advice for the message.

    Raises:
        DatasetError: The records differ; the message lists the differences.
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
    """Return descriptions of the differences between two records.

    Args:
        found: The earlier record.
        record: The later record.
        may_differ: Dotted names of entries that are not compared.
    """
    before, now = dict(flat(found)), dict(flat(record))
    return [
        f"{name} was {_word(before.get(name))} and is now {_word(now.get(name))}"
        for name in sorted({*before, *now}.difference(may_differ))
        if before.get(name) != now.get(name)
    ]


def flat(record: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values of a nested record; tuples become lists."""
    for name, value in record.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", list(value) if isinstance(value, tuple) else value


def _word(value: Any) -> str:
    if value is None:
        return "not given"
    return value if isinstance(value, str) and value else shown(value)
