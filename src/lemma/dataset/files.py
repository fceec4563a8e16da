"""Files that are either whole or not there, and what they say about themselves."""

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from subprocess import DEVNULL, SubprocessError, check_output
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lemma import __version__
from lemma.core.errors import DatasetError
from lemma.dataset.recipe.schema import (
    FORMAT_VERSION,
    PERTURBED_SCHEMA,
    SCHEMA,
    executions,
    perturbed_as,
)

METADATA_KEY = b"lemma"
MANIFEST = "manifest.json"
"""What a dataset's folder says of its files."""
CARD = "README.md"
"""What a dataset's folder says to people."""
REVISION_VARIABLE = "LEMMA_REVISION"
"""Environment variable that says the git revision where the checkout has no .git."""
ROW_GROUP = 20
"""Episodes that are read together: what random access costs."""
_DRAFT = ".draft"


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
        "numba": version("numba"),
        "revision": _revision(),
    }


def _revision() -> str:
    """Return the git revision of the package's checkout, or ``"release"``.

    Another project's repository, around an environment in which this package is
    installed, is not asked.
    """
    told = os.environ.get(REVISION_VARIABLE)
    if told:
        return told
    root = Path(__file__).parents[3]
    if not (root / "src/lemma").is_dir() or not (root / ".git").exists():
        return "release"
    try:
        return check_output(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--match="],
            cwd=root,
            stderr=DEVNULL,
            text=True,
        ).strip()
    except (OSError, SubprocessError):
        return "release"


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file so that it is whole or not there, whenever the power fails.

    Args:
        path: The file.
        write: Writes it, at the path that it is given.

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
        # Only what went wrong leaves a draft, and then its folder may be gone too.
        with suppress(OSError):
            draft.unlink()


def clear_drafts(folder: Path) -> None:
    """Remove what writers left behind that were killed."""
    for draft in folder.rglob(f".*{_DRAFT}"):
        with suppress(OSError):
            draft.unlink()


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Hold a folder, which is made if it is missing, so that nobody else writes to it.

    The system lets go of it when this process ends, however it ends.

    Raises:
        DatasetError: Somebody holds it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise DatasetError(_explain(folder, error)) from error
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(held)
        raise DatasetError(
            f"Another process is writing to {folder}. Wait until it has ended, or "
            "choose another folder."
        ) from error
    except OSError:
        # A network file system without locks: then nobody watches.
        pass
    try:
        yield
    finally:
        os.close(held)


_NO_ROOM = {
    errno.ENOSPC: "The disk is full",
    errno.EDQUOT: "Your quota of the disk is used up",
    errno.EFBIG: "Files of that size are not allowed here",
}


def check_free(folder: Path, *, begun: bool) -> None:
    """Check that a card can be written without writing over somebody else's.

    Args:
        folder: Where a dataset is to be written.
        begun: Whether some of it is there already.

    Raises:
        DatasetError: The folder holds something else.
    """
    if (folder / CARD).exists() and not begun and not (folder / MANIFEST).exists():
        raise DatasetError(
            f"{folder} has a {CARD}, but no dataset: it holds something else. Choose "
            "a folder of its own for the dataset."
        )


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


def write_table(path: Path, table: pa.Table, about: dict[str, str]) -> None:
    """Write a table of a recipe to Parquet, with what it says about itself."""
    metadata = {METADATA_KEY: json.dumps(about, sort_keys=True).encode()}
    # In one piece, because where pieces begin shows in the bytes.
    table = table.replace_schema_metadata(metadata).combine_chunks()

    def write(draft: Path) -> None:
        pq.write_table(
            table,
            draft,
            compression="zstd",
            row_group_size=ROW_GROUP,
            write_page_checksum=True,
        )

    write_whole(path, write)


def open_table(path: Path) -> tuple[pq.ParquetFile, dict[str, str]]:
    """Open a Parquet file of a recipe.

    Returns:
        The file, and what it says about itself.

    Raises:
        DatasetError: It is truncated, or not of this format.
    """
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error)) from error
    found = (file.schema_arrow.metadata or {}).get(METADATA_KEY)
    known = (SCHEMA.names, PERTURBED_SCHEMA.names)
    if found is None or file.schema_arrow.names not in known:
        raise DatasetError(
            f"{path} is no recipe of this benchmark. Recipes are written by "
            "'lemma generate'."
        )
    about: dict[str, str] = json.loads(found)
    if about.get("format") != FORMAT_VERSION:
        raise DatasetError(
            f"{path} has format {about.get('format')}, and this version of the package "
            f"reads format {FORMAT_VERSION}. Install the version that wrote it "
            f"({about.get('lemma')}), or generate it again."
        )
    return file, about


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a Parquet file of a recipe.

    Args:
        path: The file.
        columns: Names of columns; all if None.

    Raises:
        DatasetError: It is damaged, or not of this format.
    """
    file, _ = open_table(path)
    try:
        return file.read(columns=columns)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error)) from error


def damaged(path: Path, error: Exception) -> str:
    """Return what to say about a file that cannot be read."""
    return (
        f"{path} is damaged: {str(error).rstrip('.')}. It may have been cut short. "
        "Delete it and run 'lemma generate' again: it writes what is missing."
    )


def check_same(path: Path, found: dict[str, str], about: dict[str, str]) -> None:
    """Check that a file says the same about itself as what would be written now.

    Args:
        path: The file.
        found: What it says about itself.
        about: What would be written now.

    Raises:
        DatasetError: It is of another version, or perturbed otherwise.
    """
    check_alike(path, found, about)
    differing = [k for k in about if k != "revision" and found.get(k) != about[k]]
    if differing:
        what = ", ".join(f"{k} {found.get(k)} instead of {about[k]}" for k in differing)
        raise DatasetError(
            f"{path} was written by another version: {what}. Its states would not fit "
            "what is generated now. Choose a new folder, or delete this one."
        )


def check_alike(path: Path, found: dict[str, str], about: dict[str, str]) -> None:
    """Check that demonstrations and perturbed executions are not mixed.

    Args:
        path: A file, or the folder of a recipe.
        found: What it says about itself.
        about: What would be written now.

    Raises:
        DatasetError: One is perturbed and the other is not, or otherwise.
    """
    if perturbed_as(found) != perturbed_as(about):
        raise DatasetError(
            f"{path} holds {executions(found)}, and what is wanted are "
            f"{executions(about)}. Choose a new folder."
        )


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object that belongs to a recipe.

    Raises:
        DatasetError: It is missing or damaged.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise DatasetError(
            f"{path} is missing: nothing was written there, or not to the end. "
            "'lemma generate' writes it; run it again to complete the recipe."
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(
            f"{path} cannot be read: {error}. Fetch it again, or delete it and run the "
            "command again that wrote it."
        ) from error
    if not isinstance(data, dict):
        raise DatasetError(f"{path} holds no JSON object. Delete it.")
    return data


def check_files(folder: Path, *, partial: bool = False) -> None:
    """Check the files of a dataset against its manifest.

    Args:
        folder: A recipe, or what was rendered from one.
        partial: Whether files may be missing.

    Raises:
        DatasetError: One is missing, or not the one that was written, or there is no
            manifest.
    """
    manifest = read_json(folder / MANIFEST)
    files = listed_files(folder)
    written = "lemma generate" if "form" not in manifest else "lemma render"
    listed = {name for name in files if (folder / name).exists() or not partial}
    if "form" not in manifest:
        found = (path.relative_to(folder) for path in folder.glob("*/*.parquet"))
        listed.update(path.as_posix() for path in found)
    for name in sorted(listed):
        if name not in files or not (folder / name).exists():
            what = "is missing" if name in files else f"is not in {MANIFEST}"
            raise DatasetError(
                f"{folder / name} {what}. Run '{written}' again: it completes the "
                "folder and its manifest."
            )
        check_sum(folder / name, files[name], written)


def listed_files(folder: Path) -> dict[str, dict[str, Any]]:
    """Return what the manifest of a dataset says of each file.

    Raises:
        DatasetError: It is missing or damaged.
    """
    files = read_json(folder / MANIFEST).get("files", {})
    if not isinstance(files, dict) or not all(
        isinstance(entry, dict) and isinstance(entry.get("sha256"), str)
        for entry in files.values()
    ):
        raise DatasetError(
            f"{folder / MANIFEST} is damaged: it does not say what the checksums are. "
            "Fetch it again, or delete it and run the command again that wrote it."
        )
    return files


def check_sum(path: Path, entry: dict[str, Any], written: str) -> None:
    """Check that a file is the one that was written.

    Args:
        path: The file.
        entry: What the manifest says of it.
        written: The command that writes it.

    Raises:
        DatasetError: It is another one.
    """
    if sha256_of(path) != entry["sha256"]:
        raise DatasetError(
            f"{path} has another checksum than {MANIFEST} says: it was changed or "
            f"damaged. Fetch it again, or delete it and run '{written}' again: it "
            "writes what is missing."
        )


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
