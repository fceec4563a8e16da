"""The state of a training run, in a file that is never half written."""

from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from lemma.core.errors import WeightsError
from lemma.core.files import write_whole


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
    """Return the state of a training run; nothing in it is executed.

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
