"""Files of weights, and of the state of a training run. Neither is ever half written.

Weights are safetensors in 16 bits, whose metadata says which model they belong to, its
options, and where they come from. Nothing is unpickled.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from lemma.core.errors import LemmaError
from lemma.core.files import write_whole
from lemma.policies.model import Model
from lemma.policies.models.catalog import make_model

METADATA_KEY = "lemma"
WEIGHTS_VERSION = "1"


class WeightsError(LemmaError, RuntimeError):
    """Weights that cannot be found, read or used."""


@dataclass(frozen=True)
class About:
    """What a file of weights says about itself."""

    model: str
    """Its name, as ``lemma train`` knows it."""
    options: dict[str, Any]
    """Of the model."""
    data: dict[str, Any] = field(default_factory=dict)
    """Version and digest of the data that it was trained on."""
    command: str = ""
    """The command line that made it."""
    scores: dict[str, float] = field(default_factory=dict)
    """In validation."""
    training: dict[str, Any] = field(default_factory=dict)
    """All options of the run."""
    lemma: str = ""
    """Version of the package."""
    version: str = WEIGHTS_VERSION
    """Of the format."""


def write_weights(path: Path, weights: Mapping[str, Tensor], about: About) -> None:
    """Write weights, whole or not at all.

    Args:
        path: The file.
        weights: By name, as a module's ``state_dict`` has them.
        about: What it shall say about itself.

    Raises:
        WeightsError: One does not fit into 16 bits.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    packed = {}
    for name, value in weights.items():
        small = value.detach().to("cpu", copy=True).contiguous()
        if small.is_floating_point():
            small = small.half()
            if not torch.isfinite(small).all():
                raise WeightsError(
                    f"Weight {name!r} is not finite in 16 bits. Training diverged; "
                    "lower the learning rate."
                )
        packed[name] = small
    text = json.dumps(asdict(about), sort_keys=True)

    def write(draft: Path) -> None:
        save_file(packed, draft, {METADATA_KEY: text})
        # Else nobody but the owner may read them.
        draft.chmod(0o644)

    write_whole(path, write)


def read_about(path: Path) -> About:
    """Return what a file of weights says about itself.

    Raises:
        WeightsError: It is missing, damaged, or no such file.
    """
    return _read(path)[0]


def load_weights(path: Path, device: torch.device | str = "cpu") -> Model:
    """Return the model in a file of weights, ready to be used.

    Args:
        path: The file.
        device: Where it shall be.

    Raises:
        WeightsError: The file is missing, damaged, or does not fit its model.
    """
    about, weights = _read(path)
    if about.version != WEIGHTS_VERSION:
        raise WeightsError(
            f"{path} has version {about.version} of the format of weights, and this "
            f"package reads version {WEIGHTS_VERSION}. Install lemma-bench "
            f"{about.lemma}, or train again."
        )
    try:
        model = make_model(about.model, about.options)
    except LemmaError as error:
        raise WeightsError(
            f"{path} is for a model of another version of this package "
            f"({about.lemma or 'unknown'}): {error} Install that version, or train "
            f"again: {about.command or 'lemma train'}"
        ) from error
    fill(model, weights, path)
    return model.to(device).eval()


def fill(model: Model, weights: Mapping[str, Tensor], path: Path) -> None:
    """Give a model its weights.

    Raises:
        WeightsError: They are of another model, or of other options.
    """
    own = model.state_dict()
    problems = [f"{name} is missing" for name in own if name not in weights]
    problems += [f"{name} is not known" for name in weights if name not in own]
    problems += [
        f"{name} is {tuple(weights[name].shape)} instead of {tuple(own[name].shape)}"
        for name in own
        if name in weights and weights[name].shape != own[name].shape
    ]
    if problems:
        more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
        raise WeightsError(
            f"{path} does not fit {type(model).__name__} of this version: "
            f"{'; '.join(problems[:3])}{more}. Use weights that were trained with this "
            "version and the same options, or train again."
        )
    model.load_state_dict(
        {name: value.to(own[name].dtype) for name, value in weights.items()}
    )


def _read(path: Path) -> tuple[About, dict[str, Tensor]]:
    if not path.is_file():
        raise WeightsError(f"There is no file {path}. Write the path of weights.")
    try:
        with safe_open(path, "pt") as file:
            text = (file.metadata() or {}).get(METADATA_KEY)
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise WeightsError(
            f"{path} is damaged, or no file of weights: {error}. Fetch it again, or "
            "train again."
        ) from error
    if text is None:
        raise WeightsError(
            f"{path} does not say which model it is for. Only files that 'lemma "
            "train' wrote can be loaded."
        )
    try:
        about = About(**json.loads(text))
        if "recolour" in about.options:  # as it was called before
            about.options["recolor"] = about.options.pop("recolour")
        return about, weights
    except (TypeError, ValueError) as error:
        raise WeightsError(
            f"{path} was written by another version of this package: {error}."
        ) from error


def write_state(path: Path, state: dict[str, Any]) -> None:
    """Write the state of a training run, whole or not at all.

    Args:
        path: The file.
        state: Tensors, numbers, texts, lists and dictionaries.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    write_whole(path, lambda draft: torch.save(state, draft))


def read_state(path: Path, device: torch.device) -> dict[str, Any]:
    """Return the state of a training run.

    Raises:
        WeightsError: The file is damaged.
    """
    try:
        state: dict[str, Any] = torch.load(path, device, weights_only=True)
    except (OSError, RuntimeError, EOFError, ValueError, UnpicklingError) as error:
        raise WeightsError(
            f"{path} is damaged: {error}. Use --restart to begin this run anew; the "
            "best weights so far, weights.safetensors, are replaced then."
        ) from error
    return state
