"""Weights by name: published ones, files, and the Hugging Face Hub.

Finding weights does not import torch, so a misspelled name is reported quickly.
"""

import json
import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lemma.core.arguments import known, without_passwords
from lemma.core.errors import UnknownNameError, WeightsError
from lemma.core.files import read_json, sha256_of

if TYPE_CHECKING:
    import torch

    from lemma.policies.models.base import Model

LIST = "weights.json"
"""List of the published weights: file, checksum, source and command of each."""
FOLDER_VARIABLE = "LEMMA_WEIGHTS"
"""Environment variable that names a folder with files of published weights."""
CHECKOUT = Path(__file__).parents[3] / "weights"
"""Folder of weights in a checkout; an installed package has only the list."""
SUFFIX = ".safetensors"


def load_model(name: str, device: "torch.device | str" = "cpu") -> "Model":
    """Return a trained model in evaluation mode.

    Args:
        name: Published weights, such as ``"reachnet"``; a file; a folder that ``lemma
            train`` wrote; or a repository of the Hugging Face Hub, ``"org/name"`` or
            ``"org/name/file.safetensors"``.
        device: Device of the model.

    Raises:
        UnknownNameError: There are no weights with this name.
        WeightsError: The file is missing, damaged, or does not fit its model.
    """
    path = find_weights(name)
    from lemma.policies.weights_file import load_weights  # noqa: PLC0415

    return load_weights(path, device)


def find_weights(name: str) -> Path:
    """Return the file of weights with a name; download it if it is not local.

    Published weights are searched in the folder in ``LEMMA_WEIGHTS``, in the checkout,
    and in the cache of the Hub's client, in this order.

    Args:
        name: See :func:`load_model`.

    Raises:
        UnknownNameError: There are no weights with this name.
        WeightsError: The checksum is wrong, or the download failed.
    """
    published = published_weights()
    if name in published:
        return find_published(name)
    path = Path(name)
    if path.is_dir():
        return path / f"weights{SUFFIX}"
    if path.is_file() or path.is_absolute() or name.startswith("."):
        return path
    if "/" in name and path.suffix in ("", SUFFIX):
        owner, repository, *rest = name.split("/")
        return _fetch(f"{owner}/{repository}", "/".join(rest) or f"weights{SUFFIX}")
    if path.suffix == SUFFIX:
        return path
    raise UnknownNameError("weights", name, published)


def published_weights() -> dict[str, dict[str, Any]]:
    """Return the published weights by name: file, hash, source, command and scores."""
    beside = Path(__file__).with_name(LIST)
    path = CHECKOUT / LIST if (CHECKOUT / LIST).is_file() else beside
    return read_json(path) if path.exists() else {}


def find_published(name: str) -> Path:
    """Return the file of published weights; download it if it is not local.

    Raises:
        UnknownNameError: There are no published weights with this name.
        WeightsError: The checksum is wrong, or the download failed.
    """
    published = published_weights()
    entry = published[known("published weights", name, published)]
    if (found := _local(entry)) is not None:
        return _checked(found, entry)
    if entry["revision"] is None:
        raise WeightsError(
            f"The weights {name!r} are not on this machine, and not on a hub yet. They "
            f"are {entry['file']} in the folder 'weights' of the repository of "
            f"lemma-bench: copy it, and name its folder with {FOLDER_VARIABLE}=FOLDER. "
            f"Or train them: {entry['command']}"
        )
    source = entry["repository"], entry["file"], entry["revision"]
    try:
        path = _fetch(*source)
        if sha256_of(path) != entry["sha256"]:
            path = _fetch(*source, again=True)
    except WeightsError as error:
        raise WeightsError(
            f"The weights {name!r} are not on this machine. Fetch them where there is "
            f"a network: lemma pull --weights {name}. Or name a folder that has "
            f"{entry['file']} with {FOLDER_VARIABLE}=FOLDER. ({error})"
        ) from error
    return _checked(path, entry)


def are_here(name: str) -> bool:
    """Return whether published weights are local, without checking their checksum."""
    entry = published_weights().get(name)
    return entry is not None and _local(entry) is not None


def _local(entry: dict[str, Any]) -> Path | None:
    configured = os.environ.get(FOLDER_VARIABLE)
    for folder in (Path(configured) if configured else None, CHECKOUT):
        if folder is not None and (path := Path(folder, entry["file"])).is_file():
            return path
    return None


def _checked(path: Path, entry: dict[str, Any]) -> Path:
    if sha256_of(path) != entry["sha256"]:
        raise WeightsError(
            f"{path} is not the file that was published: its checksum differs. Remove "
            "it, and fetch it again: git checkout, or lemma pull --weights."
        )
    return path


def _fetch(
    repository: str, file: str, revision: str | None = None, *, again: bool = False
) -> Path:
    """Return a file of the Hub, from the cache or downloaded.

    Raises:
        WeightsError: The download failed, or the Hub's client is not installed.
    """
    name = f"{repository}/{file}"
    try:
        hub = import_module("huggingface_hub")
    except ImportError as error:
        raise WeightsError(
            f"{name} is no local file, and a download from the Hugging Face Hub needs "
            "another package: python -m pip install 'lemma-bench[hub]'"
        ) from error
    try:
        return Path(
            hub.hf_hub_download(
                repository, file, revision=revision, force_download=again
            )
        )
    except UnicodeError:
        # The error may show parts of the token.
        raise WeightsError(
            f"{name} is no local file, and the token for the Hugging Face Hub is "
            "invalid: it has a curly quotation mark or another character that is not "
            "ASCII. Set HF_TOKEN again, or log in with: hf auth login"
        ) from None
    except (OSError, ValueError) as error:
        known = ", ".join(published_weights()) or "none"
        raise WeightsError(
            f"{name} is no local file, and the Hugging Face Hub does not have it: "
            f"{_first_line(error)} Published weights: {known}."
        ) from error


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return json.dumps(without_passwords(lines[0]))
