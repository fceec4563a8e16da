"""LeRobot checkpoints in one packed file, the format of published weights.

A checkpoint is a folder: weights, configuration, and the pre- and post-processors with
the statistics of the data. The file holds all of it except the paths of the training
machine; lerobot reads the unpacked folder.
"""

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from lemma.core.errors import WeightsError
from lemma.policies.class_path import LEROBOT
from lemma.policies.weights import find_published, published_weights
from lemma.policies.weights_file import read_metadata, unpack

MODEL = "model.safetensors"
"""File of a checkpoint with its weights."""
FILE = "file:"
"""Prefix of the name of a tensor with the bytes of a file of the folder."""
FILE_NAME = re.compile(r"[a-z0-9_]+\.(json|safetensors)")
"""Valid names of these files."""


def unpack_checkpoint(path: Path, folder: Path) -> None:
    """Unpack a file to a folder that lerobot reads.

    Args:
        path: A published file, which ``scripts/publish_weights.py pack`` wrote.
        folder: Existing folder to write to.

    Raises:
        WeightsError: The file is damaged, it is no LeRobot checkpoint, or the folder
            cannot be written to.
    """
    metadata = read_metadata(path)
    if not metadata.model.startswith(LEROBOT):
        raise WeightsError(
            f"{path} has weights of {metadata.model}, which is no policy of LeRobot. "
            "Leave out 'lerobot:'."
        )
    weights, files = {}, {}
    try:
        with safe_open(path, "pt") as file:
            for name in file.keys():  # noqa: SIM118 - it is no mapping
                value = file.get_tensor(name)
                if name.startswith(FILE):
                    files[name.removeprefix(FILE)] = value
                elif name in metadata.packed:
                    weights[name] = unpack(value, metadata.packed[name])
                else:
                    fraction = value.is_floating_point()
                    weights[name] = value.float() if fraction else value
        for name, value in files.items():
            if not FILE_NAME.fullmatch(name) or value.dtype != torch.uint8:
                raise ValueError(f"{name!r} is no file of a checkpoint")
    except (SafetensorError, OSError, ValueError) as error:
        raise WeightsError(f"{path} is damaged: {error}. Fetch it again.") from error
    try:
        for name, value in files.items():
            (folder / name).write_bytes(value.numpy().tobytes())
        save_file(weights, folder / MODEL)
    except (SafetensorError, OSError) as error:
        raise _no_room(path, error) from error


def _no_room(path: Path, error: Exception) -> WeightsError:
    return WeightsError(
        f"{path} cannot be unpacked for lerobot: {error}. Free some space in the "
        "folder of temporary files, or name another one in the environment variable "
        "TMPDIR."
    )


@contextmanager
def checkpoint_folder(name: str) -> Iterator[str]:
    """Yield a folder or a name that lerobot can load; unpack published weights.

    Args:
        name: Name of published weights, which are in a temporary folder within the
            context; or a folder or a repository of the Hub, which is yielded unchanged.

    Raises:
        WeightsError: There is no such checkpoint, published weights are missing or
            damaged, or there is no space for temporary files.
    """
    published = published_weights()
    if name not in published:
        if not Path(name).is_dir() and name.count("/") != 1:
            ours = (n for n in published if published[n]["model"].startswith(LEROBOT))
            raise WeightsError(
                f"There is no checkpoint {name}. Valid: a folder that lerobot-train "
                "wrote, .../checkpoints/last/pretrained_model; OWNER/NAME on the Hub; "
                f"or published weights: {', '.join(ours) or 'none yet'}."
            )
        yield name
        return
    path = find_published(name)
    with ExitStack() as stack:
        try:
            folder = stack.enter_context(TemporaryDirectory())
        except OSError as error:
            raise _no_room(path, error) from error
        unpack_checkpoint(path, Path(folder))
        yield folder
