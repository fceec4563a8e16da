"""Upload and download of datasets on the Hugging Face Hub, with checksums."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from lemma.core.arguments import without_passwords
from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import sha256_of
from lemma.core.workers.resumable import PARTS
from lemma.dataset.files import MANIFEST, check_files, listed_files

_KIND = "dataset"
_HIDDEN = [".*", ".*/**", "**/.*"]
"""Patterns of files that are never uploaded: drafts, parts, caches."""
_TRANSPORTS = ("httpx", "httpcore", "requests", "urllib3")


def push(folder: Path, repository: str, *, private: bool = False) -> str:
    """Upload a dataset: a recipe or rendered data.

    Args:
        folder: The dataset.
        repository: ``"owner/name"``; created if it is missing.
        private: Whether to create it as a private repository.

    Returns:
        The URL of the upload.

    Raises:
        DatasetError: The dataset is incomplete or damaged; the Hub cannot be reached
            or denies access; or its client is not installed.
    """
    _check_name(repository)
    check(folder)
    client = _client()
    with _explained(repository):
        client.create_repo(repository, repo_type=_KIND, private=private, exist_ok=True)
        done = client.upload_folder(
            repo_id=repository,
            folder_path=folder,
            repo_type=_KIND,
            ignore_patterns=_HIDDEN,
            commit_message=f"Upload {folder.resolve().name}",
        )
    return str(done.commit_url)


def pull(
    repository: str,
    out: Path,
    *,
    revision: str | None = None,
    splits: Sequence[str] = (),
) -> Path:
    """Download a dataset, and check its files.

    Existing files are not fetched again, so a second call continues an interrupted one.

    Args:
        repository: ``"owner/name"``.
        out: Folder for the dataset.
        revision: Branch, tag or commit; None for the main branch.
        splits: Names of splits to fetch; empty for all.

    Returns:
        The folder.

    Raises:
        DatasetError: The dataset cannot be fetched or is damaged, or the client of the
            Hub is not installed.
        OSError: The folder cannot be written to.
    """
    _check_name(repository)
    damaged = _fetch(repository, out, revision, splits)
    for split in splits:
        if not (out / split).is_dir():
            raise DatasetError(
                f"{repository} has no files of split {split!r}. Leave out the splits "
                "to fetch all of them."
            )
    if damaged:
        raise DatasetError(
            f"{out / damaged[0]} was damaged after two downloads: its checksum is not "
            f"that in {MANIFEST}. Run the same command again. If this does not help, "
            f"the file in {repository} is damaged."
        )
    try:
        check(out, partial=bool(splits))
    except DatasetError as error:
        raise DatasetError(
            f"The dataset in {repository} is not complete. {error}"
        ) from error
    return out


def _fetch(
    repository: str, out: Path, revision: str | None, splits: Sequence[str]
) -> list[str]:
    """Download a dataset; return the files that are damaged after two downloads."""
    client = _client()
    patterns = ["*.json", "*.md", *(f"{split}/*" for split in splits)]
    with _explained(repository):
        # Request the commit first: without a connection, the download would silently
        # return the existing files.
        commit = client.dataset_info(repository, revision=revision).sha
        out.mkdir(parents=True, exist_ok=True)
        fetch = partial(
            client.snapshot_download,
            repository,
            repo_type=_KIND,
            revision=commit,
            local_dir=out,
        )
        fetch(allow_patterns=patterns if splits else None)
        # The client compares only sizes, and does not fetch an existing file again.
        if not (damaged := _damaged(out)):
            return []
        fetch(allow_patterns=damaged, force_download=True)
    return _damaged(out)


def _damaged(folder: Path) -> list[str]:
    """Return the existing files with a wrong checksum."""
    if not (folder / MANIFEST).exists():
        return []
    return [
        name
        for name, entry in listed_files(folder).items()
        if (folder / name).is_file() and sha256_of(folder / name) != entry["sha256"]
    ]


def check(folder: Path, *, partial: bool = False) -> None:
    """Check that a dataset is complete.

    Args:
        folder: The dataset.
        partial: Whether files may be missing.

    Raises:
        DatasetError: The dataset is missing, incomplete or damaged.
    """
    if (folder / PARTS).exists():
        raise DatasetError(
            f"{folder} is not complete: the command that writes it was interrupted. "
            "Run the same command again first."
        )
    if not folder.is_dir() or not any(_content(folder)):
        raise DatasetError(
            f"There is no dataset in {folder}. Write one with 'lemma generate' or "
            "'lemma render'."
        )
    # A LeRobotDataset has no such manifest.
    if (folder / MANIFEST).exists():
        check_files(folder, partial=partial)


def _content(folder: Path) -> Iterator[Path]:
    """Yield the files of a dataset, which are those in its subfolders."""
    return (path for path in folder.glob("[!.]*/**/*") if path.is_file())


def _check_name(repository: str) -> None:
    owner, slash, name = repository.partition("/")
    if not (owner and slash and name) or "/" in name:
        raise InvalidConfigError(
            f"{repository!r} is not a repository of the Hub. Write owner/name."
        )


def _client() -> Any:
    try:
        from huggingface_hub import HfApi  # noqa: PLC0415 - an extra, used here alone
    except ImportError as error:
        raise DatasetError(
            "The client of the Hugging Face Hub is not installed. Install it with: pip "
            "install 'lemma-bench[hub]'."
        ) from error
    return HfApi(library_name="lemma-bench")


@contextmanager
def _explained(repository: str) -> Iterator[None]:
    """Turn an error of the client into a message with advice.

    Raises:
        DatasetError: The message.
    """
    try:
        yield
    except Exception as error:
        if (words := _words(error, repository)) is None:
            raise
        raise DatasetError(words) from error


def _words(error: Exception, repository: str) -> str | None:
    """Return the message; None if the error is not about the Hub."""
    chain = list(_chain(error))
    answers = (getattr(link, "response", None) for link in chain)
    found = (getattr(answer, "status_code", None) for answer in answers)
    status = next((code for code in found if code is not None), None)
    if status in (401, 403):
        return (
            f"The Hub denies access to {repository} ({status}): it does not exist, or "
            "your token lacks the permission. Check the name, and log in with: hf auth "
            "login"
        )
    if status == 404:
        return (
            f"The Hub has no dataset {repository}, or not this revision. Check the "
            "name."
        )
    if status is not None:
        why = without_passwords(" ".join(str(error).split()))
        return f"The Hub answered {status} about {repository}. Try again later. ({why})"
    if any(_is_transport(link) for link in chain):
        return (
            f"The Hub could not be reached ({type(error).__name__}). Check the "
            "network, the proxy, and HF_ENDPOINT and HF_HUB_OFFLINE if they are set. "
            "The same command continues where it was stopped."
        )
    if isinstance(error, UnicodeEncodeError):
        return (
            "The token of the Hub cannot be sent: it has a curly quotation mark or "
            "another character that is not ASCII. Set HF_TOKEN again, or log in with: "
            "hf auth login"
        )
    if type(error).__name__ == "HFValidationError":
        why = " ".join(str(error).split())
        return (
            f"{repository!r} is not a repository of the Hub. Write owner/name. ({why})"
        )
    return None


def _chain(error: BaseException) -> Iterator[BaseException]:
    """Yield an error and its causes."""
    link: BaseException | None = error
    while link is not None:
        yield link
        link = link.__cause__ or link.__context__


def _is_transport(error: BaseException) -> bool:
    """Return whether an error means that the Hub did not answer."""
    if isinstance(error, ConnectionError | TimeoutError):
        return True
    names = {
        (kind.__module__.partition(".")[0].rstrip("0123456789"), kind.__name__)
        for kind in type(error).__mro__
    }
    return any(
        module in _TRANSPORTS
        or name in ("LocalEntryNotFoundError", "OfflineModeIsEnabled")
        for module, name in names
    )
