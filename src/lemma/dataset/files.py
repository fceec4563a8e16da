"""Files that are either whole or not there, and what they say about themselves."""

import errno
import hashlib
import json
import os
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from subprocess import DEVNULL, SubprocessError, check_output
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lemma import __version__
from lemma.core.errors import DatasetError
from lemma.dataset.schema import FORMAT_VERSION, SCHEMA

METADATA_KEY = b"lemma"
ROW_GROUP = 20
"""Episodes that are read together: what random access costs."""


def versions(benchmark: str) -> dict[str, str]:
    """Return what the bits of a recipe depend on.

    Args:
        benchmark: Version of the benchmark's instances.
    """
    return {
        "format": FORMAT_VERSION,
        "benchmark": benchmark,
        "lemma": __version__,
        "mujoco": version("mujoco"),
        "numpy": version("numpy"),
        "revision": _revision(),
    }


def _revision() -> str:
    """Return the git revision of the package's checkout, or ``"release"``."""
    try:
        text = check_output(
            ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, stderr=DEVNULL
        )
    except (OSError, SubprocessError):
        return "release"
    return text.decode().strip()


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file so that it is whole or not there, whenever the power fails.

    Args:
        path: The file.
        write: Writes it, at the path that it is given.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(draft)
        with draft.open("rb+") as file:
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise DatasetError(_explain(path, error)) from error


def _explain(path: Path, error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return (
            f"The disk is full: {path} could not be written. Nothing that was written "
            "before is lost. Free some space and run the same command again."
        )
    return (
        f"{path} cannot be written: {error.strerror or error}. Choose a folder that "
        "you may write to; nothing that was written before is lost."
    )


def write_table(path: Path, table: pa.Table, about: dict[str, str]) -> None:
    """Write a table of :data:`SCHEMA` to Parquet, with what it says about itself."""
    metadata = {METADATA_KEY: json.dumps(about, sort_keys=True).encode()}
    table = table.replace_schema_metadata(metadata)

    def write(draft: Path) -> None:
        pq.write_table(table, draft, compression="zstd", row_group_size=ROW_GROUP)

    write_whole(path, write)


def open_table(path: Path) -> tuple[pq.ParquetFile, dict[str, str]]:
    """Open a Parquet file of a recipe.

    Returns:
        The file, and what it says about itself.

    Raises:
        DatasetError: It is truncated, or not of this format.
    """
    try:
        file = pq.ParquetFile(path)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(
            f"{path} cannot be read: {error}. It may have been cut short. Delete it "
            "and run 'lemma generate' again: it writes what is missing."
        ) from error
    found = (file.schema_arrow.metadata or {}).get(METADATA_KEY)
    if found is None or file.schema_arrow.names != SCHEMA.names:
        raise DatasetError(
            f"{path} is no recipe of this benchmark. Recipes are written by "
            "'lemma generate'."
        )
    about: dict[str, str] = json.loads(found)
    if about["format"] != FORMAT_VERSION:
        raise DatasetError(
            f"{path} has format {about['format']}, and this version of the package "
            f"reads format {FORMAT_VERSION}. Install the version that wrote it "
            f"({about['lemma']}), or generate it again."
        )
    return file, about


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON, the same bytes for the same data."""
    write_text(path, json.dumps(data, indent=1, sort_keys=True) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""

    def write(draft: Path) -> None:
        draft.write_text(text, encoding="utf-8")

    write_whole(path, write)
