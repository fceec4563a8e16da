"""Atomic writing of files, JSON, checksums, and locks of folders."""

import errno
import hashlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from filelock import FileLock, Timeout

from lemma.core.errors import DatasetError

_DRAFT = ".draft"
_LOCK = ".lock"


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file atomically: after a crash it is complete or absent.

    Args:
        path: The file.
        write: Writes the content to the path that it gets.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}{_DRAFT}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(draft)
        with draft.open("rb+") as file:
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        raise DatasetError(_explain(path, error)) from error
    finally:
        # After an error the draft remains, unless its folder is gone too.
        with suppress(OSError):
            draft.unlink()


def clear_drafts(folder: Path) -> None:
    """Remove the drafts of killed writers."""
    for draft in folder.rglob(f".*{_DRAFT}"):
        with suppress(OSError):
            draft.unlink()


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Lock a folder for writing; create it if it is missing.

    An empty file ``.lock`` remains. The system releases the lock when this process
    ends, also after a crash. Drafts of killed writers are removed.

    Raises:
        DatasetError: Another process has the lock, or the folder cannot be created.
    """
    lock = FileLock(folder / _LOCK, timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Some network file systems have no locks: go on without one.
        with suppress(NotImplementedError):
            lock.acquire()
    except Timeout as error:
        raise DatasetError(
            f"Another process is writing to {folder}. Wait until it has ended, or "
            "choose another folder."
        ) from error
    except OSError as error:
        raise DatasetError(_explain(folder, error)) from error
    try:
        clear_drafts(folder)
        yield
    finally:
        clear_drafts(folder)
        lock.release()


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a temporary folder, which is removed at the end.

    Raises:
        DatasetError: The folder cannot be created.
    """
    try:
        folder = TemporaryDirectory(ignore_cleanup_errors=True)
    except OSError as error:
        raise DatasetError(
            f"No temporary folder can be made: {error.strerror or error}. Free some "
            "space, or let TMPDIR name a folder that you may write to."
        ) from error
    with folder as name:
        yield Path(name)


_NO_ROOM = {
    errno.ENOSPC: "The disk is full",
    errno.EDQUOT: "Your quota of the disk is used up",
    errno.EFBIG: "Files of that size are not allowed here",
}


def _explain(path: Path, error: OSError) -> str:
    if error.errno in _NO_ROOM:
        return (
            f"{_NO_ROOM[error.errno]}: {path} could not be written. Nothing that was "
            "written before is lost. Free some space, or ask for more, and run the "
            "same command again."
        )
    return (
        f"{path} cannot be written: {error.strerror or error}. Choose a folder that "
        "you may write to; nothing that was written before is lost."
    )


def damaged(path: Path, error: Exception, command: str) -> str:
    """Return a message about a file that cannot be read.

    Args:
        path: The file.
        error: The reason.
        command: Command that writes it, such as ``"lemma generate"``.
    """
    return (
        f"{path} is damaged: {str(error).rstrip('.')}. It may have been cut short. "
        f"Delete it and run '{command}' again: it writes what is missing."
    )


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        DatasetError: The file is missing, damaged, nested too deeply, or no object.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DatasetError(
            f"{path} is missing: the command that writes it did not run, or did not "
            "finish. Run it again, such as 'lemma generate' for a recipe."
        ) from error
    except (OSError, ValueError) as error:
        raise DatasetError(_unreadable(path, error)) from error
    return parse_json(text, path)


def parse_json(text: str | bytes, path: Path) -> dict[str, Any]:
    """Parse a JSON object.

    Args:
        text: The JSON.
        path: File that contains it, for error messages.

    Raises:
        DatasetError: The text is damaged, nested too deeply, or no object.
    """
    try:
        data = json.loads(text)
    # Deeply nested brackets raise a RecursionError in the parser.
    except (ValueError, RecursionError) as error:
        raise DatasetError(_unreadable(path, error)) from error
    if not isinstance(data, dict):
        raise DatasetError(_unreadable(path, "it is no JSON object"))
    return data


def _unreadable(path: Path, why: object) -> str:
    return (
        f"{path} cannot be read: {str(why).rstrip('.')}. Fetch it again, or delete it "
        "and run the command again that wrote it."
    )


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON atomically; equal data give equal bytes.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    write_text(path, json.dumps(data, indent=1, sort_keys=True) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """

    def write(draft: Path) -> None:
        draft.write_text(text, encoding="utf-8")

    write_whole(path, write)
