"""The files of a rendered data set, and whether they are unchanged.

Neither MuJoCo nor torch is needed.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.core.files import read_json, sha256_of
from lemma.dataset.files import MANIFEST, listed_files
from lemma.dataset.rendered.keyframes.files import KeyframeFile
from lemma.dataset.rendered.keyframes.schema import FORM, PARTS, Header


@dataclass(frozen=True, slots=True)
class Shard:
    """Files side by side, with the same keyframes."""

    task: str
    split: str
    paths: dict[str, Path]
    """By part."""
    header: Header
    """Header of the maps."""


def keyframe_shards(folder: Path, split: str, tasks: Sequence[str] = ()) -> list[Shard]:
    """Return the files of a split of rendered keyframes.

    Args:
        folder: Written by ``lemma render --form keyframes``.
        split: Name of a split.
        tasks: Names of tasks; all if empty.

    Raises:
        DatasetError: Files are missing, cut short, or of another version.
        UnknownNameError: There is no such split or task.
    """
    names = choose(folder, FORM, PARTS[0], split, tasks)
    shards = []
    for name in names:
        paths = {part: folder / part / split / Path(name).name for part in PARTS}
        header = KeyframeFile(paths[PARTS[0]]).header
        shards.append(Shard(_task_of(name), split, paths, header))
    return shards


def choose(
    folder: Path, form: str, part: str, split: str, tasks: Sequence[str] = ()
) -> list[str]:
    """Return the files of a part and split that the manifest names.

    Args:
        folder: Folder that ``lemma render`` wrote.
        form: Its form.
        part: First folder of the files' paths.
        split: Name of a split.
        tasks: Names of tasks; all if empty.

    Raises:
        DatasetError: Files are missing or cut short.
        UnknownNameError: There is no such split or task.
    """
    files = read_manifest(folder, form)
    for name, entry in files.items():
        _check_size(folder / name, entry)
    there = [name for name in files if Path(name).parts[0] == part]
    _check_name("split in this data set", split, {_split_of(name) for name in there})
    there = [name for name in there if _split_of(name) == split]
    for task in tasks:
        _check_name(f"task of split {split!r}", task, {_task_of(n) for n in there})
    return [name for name in there if _task_of(name) in (tasks or (_task_of(name),))]


def read_manifest(folder: Path, form: str) -> dict[str, dict[str, Any]]:
    """Return what the manifest of a rendered data set says of its files.

    Raises:
        DatasetError: There is none, or it is one of another form.
    """
    if not (folder / MANIFEST).exists():
        raise DatasetError(
            f"{folder} has no {MANIFEST}: nothing was rendered there, or not to the "
            f"end. Run 'lemma render --form {form} --out {quote(str(folder))}' "
            "(again)."
        )
    manifest = read_json(folder / MANIFEST)
    if manifest.get("form") != form:
        raise DatasetError(
            f"{folder} holds {manifest.get('form', 'recipe')!r}, not {form!r}. Choose "
            f"another folder, or make one with 'lemma render --form {form}'."
        )
    return listed_files(folder)


def verify(folder: Path, form: str = FORM) -> int:
    """Compare the checksum of every file with the manifest's.

    Args:
        folder: Folder that ``lemma render`` wrote.
        form: Its form.

    Returns:
        The number of files.

    Raises:
        DatasetError: One is missing or was changed.
    """
    files = read_manifest(folder, form)
    for name, entry in files.items():
        _check_size(folder / name, entry)
        if sha256_of(folder / name) != entry["sha256"]:
            raise DatasetError(changed(folder / name))
    return len(files)


def changed(path: Path) -> str:
    """Return the message about a file whose checksum is wrong."""
    return (
        f"{path} has another checksum than {MANIFEST} says: it was changed or "
        "damaged. Delete it and run 'lemma render' again: it makes what is missing."
    )


def _check_size(path: Path, entry: dict[str, Any]) -> None:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise DatasetError(
            f"{path} is missing. Run 'lemma render' again: it makes what is missing."
        ) from error
    if size != entry.get("bytes"):
        raise DatasetError(
            f"{path} has {size} bytes, but {MANIFEST} says {entry.get('bytes')}: it "
            "was cut short or changed. Delete it and run 'lemma render' again."
        )


def _check_name(kind: str, name: str, valid: Collection[str]) -> None:
    if name not in valid:
        raise UnknownNameError(kind, name, sorted(valid))


def _split_of(name: str) -> str:
    return Path(name).parent.name


def _task_of(name: str) -> str:
    """Return the task of a file: ``"stack"`` of ``maps/train/stack-003.arrow``."""
    return Path(name).stem.rpartition("-")[0]
