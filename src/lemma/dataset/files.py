"""The manifest of a data set, its checksums, and its card."""

import hashlib
from collections.abc import Iterable
from importlib.resources import files as resources
from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Any

import msgspec

from lemma.core.errors import DatasetError
from lemma.core.files import read_json, sha256_of

MANIFEST = "manifest.json"
"""File of a data set that lists its files with checksums."""
CARD = "README.md"
"""File with the description of a data set."""


class _Entry(msgspec.Struct):
    """The required fields of a file's entry in the manifest."""

    sha256: str
    digests: tuple[str, ...] = ()
    bytes: int = 0
    episodes: int = 0


def card(name: str, **values: object) -> str:
    """Return the README of a data set, with the header that the Hub reads.

    Args:
        name: Name of a text in the folder ``cards``, without ending.
        **values: Values of its fields.
    """
    text = resources("lemma.dataset") / "cards" / f"{name}.md"
    return text.read_text(encoding="utf-8").format(**values)


def check_free(folder: Path, *, begun: bool) -> None:
    """Check that the card of a data set overwrites no other file.

    Args:
        folder: Folder for the dataset.
        begun: Whether the folder already contains a part of the dataset.

    Raises:
        DatasetError: The folder contains something else.
    """
    if (folder / CARD).exists() and not begun and not (folder / MANIFEST).exists():
        raise DatasetError(
            f"{folder} has a {CARD}, but no dataset. Choose another folder for the "
            "dataset."
        )


def check_files(folder: Path, *, partial: bool = False) -> None:
    """Check the files of a dataset against its manifest.

    Args:
        folder: A recipe or rendered data.
        partial: Whether files may be missing.

    Raises:
        DatasetError: A file is missing or changed, or there is no manifest.
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


def read_manifest(folder: Path, form: str) -> dict[str, dict[str, Any]]:
    """Return the entries of the files in the manifest of a rendered data set.

    Args:
        folder: The data set.
        form: Expected form of the data set, such as ``"keyframes"``.

    Raises:
        DatasetError: There is no manifest, or it is of another form.
    """
    if not (folder / MANIFEST).exists():
        raise DatasetError(
            f"{folder} has no {MANIFEST}: it has no rendered data, or the rendering "
            f"was interrupted. Run 'lemma render --form {form} --out "
            f"{quote(str(folder))}' (again)."
        )
    manifest = read_json(folder / MANIFEST)
    if manifest.get("form") != form:
        raise DatasetError(
            f"{folder} has {manifest.get('form', 'recipe')!r}, not {form!r}. Choose "
            f"another folder, or make one with 'lemma render --form {form}'."
        )
    return listed_files(folder)


def listed_files(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the entry of each file in the manifest, by path in the folder.

    Raises:
        DatasetError: The manifest is missing or damaged.
    """
    files = read_json(folder / MANIFEST).get("files", {})
    try:
        for name in msgspec.convert(files, dict[str, _Entry]):
            if PurePosixPath(name).is_absolute() or ".." in name.split("/"):
                raise msgspec.ValidationError(f"{name!r} is not in the folder")
    except msgspec.ValidationError as error:
        raise DatasetError(_damaged(folder, str(error))) from error
    found: dict[str, dict[str, Any]] = files
    return found


def listed_versions(folder: Path) -> dict[str, str]:
    """Return the versions in the manifest of a recipe.

    Raises:
        DatasetError: The manifest is missing or damaged.
    """
    found = read_json(folder / MANIFEST).get("versions", {})
    try:
        return msgspec.convert(found, dict[str, str])
    except msgspec.ValidationError as error:
        raise DatasetError(_damaged(folder, str(error))) from error


def _damaged(folder: Path, why: str) -> str:
    return (
        f"{folder / MANIFEST} is damaged: {why.rstrip('.')}. Fetch it again, or delete "
        "it and repeat the command that wrote it."
    )


def check_sum(path: Path, entry: dict[str, Any] | None, written: str) -> str:
    """Return the SHA-256 of a file, and check that the file is unchanged.

    Args:
        path: The file.
        entry: Its entry in the manifest; None without one.
        written: The command that writes the file.

    Raises:
        DatasetError: The file was changed.
    """
    found = sha256_of(path)
    if entry is not None and found != entry["sha256"]:
        raise DatasetError(
            f"{path} has another checksum than in {MANIFEST}: it was changed or "
            f"damaged. Fetch it again, or delete it and run '{written}' again, which "
            "writes missing files."
        )
    return found


def shorten(digest: str) -> str:
    """Return the first 128 bits of a SHA-256, as hexadecimal digits."""
    return digest[:32]


def content_digest(digests: Iterable[str]) -> str:
    """Return the SHA-256 of the digests of a file's or a split's episodes."""
    return hashlib.sha256("".join(digests).encode()).hexdigest()
