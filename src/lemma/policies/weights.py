"""Weights by name: those that ship, files, and the Hugging Face Hub."""

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from lemma.core.errors import UnknownNameError
from lemma.core.files import read_json, sha256_of, write_json
from lemma.policies.checkpoints import WeightsError, load_weights, read_about
from lemma.policies.model import Model

SHIPPED = Path(__file__).with_name("trained")
"""Where weights that ship lie: in the package, so that a checkout, an editable
installation and a wheel find them at the same place."""
LIST = "weights.json"
"""Says what each of them is."""
LARGEST_MB = 35.0
SUFFIX = ".safetensors"


def load_model(name: str, device: torch.device | str = "cpu") -> Model:
    """Return a trained model, ready to be used.

    Args:
        name: Weights that ship, such as ``"reachnet"``; a file; a folder that ``lemma
            train`` wrote; or a repository of the Hugging Face Hub, ``"org/name"`` or
            ``"org/name/file.safetensors"``.
        device: Where it shall be.

    Raises:
        UnknownNameError: Nothing is called that.
        WeightsError: The file is missing, damaged, or does not fit its model.
    """
    return load_weights(find_weights(name), device)


def find_weights(name: str, folder: Path = SHIPPED) -> Path:
    """Return the file of weights that a name means.

    Args:
        name: See :func:`load_model`.
        folder: Where those lie that ship.

    Raises:
        UnknownNameError: Nothing is called that.
        WeightsError: It is not the file that ships.
    """
    shipped = shipped_weights(folder)
    if name in shipped:
        return _checked(name, shipped[name], folder)
    path = Path(name)
    if path.is_dir():
        return path / f"weights{SUFFIX}"
    if path.is_file() or path.is_absolute() or name.startswith("."):
        return path
    if "/" in name and path.suffix in ("", SUFFIX):
        return _from_hub(name)
    if path.suffix == SUFFIX:
        return path
    raise UnknownNameError("weights", name, shipped)


def shipped_weights(folder: Path = SHIPPED) -> dict[str, dict[str, Any]]:
    """Return what ships, by name: file, hash, data version, command and scores."""
    path = folder / LIST
    return read_json(path) if path.exists() else {}


def ship(source: Path, name: str, folder: Path = SHIPPED) -> Path:
    """Add the weights of a training run to those that ship.

    Args:
        source: A file of weights, or the folder of a run.
        name: What they shall be called.
        folder: Where those lie that ship.

    Returns:
        The file.

    Raises:
        WeightsError: They are missing, damaged or too large.
    """
    source = find_weights(str(source), folder)
    about = read_about(source)
    # Fits the model of this very version.
    load_weights(source)
    size_mb = source.stat().st_size / 1e6
    if size_mb > LARGEST_MB:
        raise WeightsError(
            f"{source} has {size_mb:.1f} MB; at most {LARGEST_MB:.0f} MB ship. Train a "
            "smaller model."
        )
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{name}{SUFFIX}"
    target.write_bytes(source.read_bytes())
    entry = {
        "file": target.name,
        "sha256": sha256_of(target),
        "bytes": target.stat().st_size,
        "model": about.model,
        "data": about.data,
        "command": about.command,
        "scores": about.scores,
        "lemma": about.lemma,
    }
    write_json(folder / LIST, {**shipped_weights(folder), name: entry})
    return target


def _checked(name: str, entry: dict[str, Any], folder: Path) -> Path:
    path: Path = folder / entry["file"]
    if not path.is_file():
        raise WeightsError(
            f"The weights {name!r} are not part of this installation: {path} is "
            "missing. They are in the repository of lemma-bench; install it from there "
            f"or train them: {entry['command']}"
        )
    if sha256_of(path) != entry["sha256"]:
        raise WeightsError(
            f"{path} is not the file that ships: its checksum differs. Install "
            "lemma-bench again, or fetch the file from its repository."
        )
    return path


def _from_hub(name: str) -> Path:
    """Return a file of the Hub, downloaded unless it was before."""
    owner, repository, *rest = name.split("/")
    file = "/".join(rest) or f"weights{SUFFIX}"
    try:
        hub = import_module("huggingface_hub")
    except ImportError as error:
        raise WeightsError(
            f"{name} is no file here, and to fetch it from the Hugging Face Hub takes "
            "another package: python -m pip install 'lemma-bench[hub]'"
        ) from error
    try:
        return Path(hub.hf_hub_download(f"{owner}/{repository}", file))
    except (OSError, ValueError) as error:
        known = ", ".join(shipped_weights()) or "none"
        raise WeightsError(
            f"{name} is no file here, and the Hugging Face Hub does not give it: "
            f"{_first_line(error)} Weights that ship: {known}."
        ) from error


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return json.dumps(lines[0])
