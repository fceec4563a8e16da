"""Checkpoints of LeRobot in one file of a few bits a weight, as weights are published.

A checkpoint is a folder: weights, configuration, and what comes before and after the
network with the statistics of its data. The file holds all of it but where it was
trained; unpacked, lerobot reads it as its own.
"""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from lemma.core.errors import WeightsError
from lemma.core.files import read_json
from lemma.policies.class_path import LEROBOT
from lemma.policies.packing import Fineness, PackingError, unpack
from lemma.policies.weights import find_published, published_weights
from lemma.policies.weights_file import (
    TIME_LIMIT,
    WeightsMetadata,
    read_metadata,
    write_weights,
)

CONFIG, MODEL, TRAINING = "config.json", "model.safetensors", "train_config.json"
_FILE = "file:"
"""Begins the name of what is a file of the folder, byte by byte."""
_NAME = re.compile(r"[a-z0-9_]+\.(json|safetensors)")
_PLACES = ("pretrained_path", "device")
"""Entries of a configuration that hold places of the machine."""


def is_checkpoint(folder: Path) -> bool:
    """Return whether a folder is what lerobot saved."""
    return (folder / CONFIG).is_file() and (folder / MODEL).is_file()


def pack_checkpoint(
    folder: Path, path: Path, command: str, fineness: Fineness
) -> WeightsMetadata:
    """Write a checkpoint into one file.

    Args:
        folder: ``.../checkpoints/last/pretrained_model``, or that of a number of steps.
        path: The file.
        command: Command line that trained it.
        fineness: How finely weights are rounded.

    Returns:
        The metadata of the file.

    Raises:
        WeightsError: A weight does not fit into 16 bits, or lerobot-train has not
            written the folder.
        DatasetError: It is no checkpoint, the disk is full, or the folder cannot be
            written to.
    """
    config, training = read_json(folder / CONFIG), read_json(folder / TRAINING)
    # The folder above has the number of steps for its name; the last one is a link.
    above = folder.resolve().parent.name
    if not above.isdigit():
        raise WeightsError(
            f"{folder} does not say after how many steps it was saved. Take the folder "
            "that lerobot-train wrote: .../checkpoints/last/pretrained_model."
        )
    steps = int(above)
    metadata = WeightsMetadata(
        model=f"{LEROBOT}{config['type']}",
        options={},
        data={"repo_id": training["dataset"]["repo_id"]},
        command=command,
        training={"seed": training["seed"] or 0, "batch_size": training["batch_size"]},
        ended="steps" if steps >= training["steps"] else TIME_LIMIT,
        steps=steps,
    )
    here = {name: value for name, value in config.items() if name not in _PLACES}
    files = {CONFIG: json.dumps(here, indent=4).encode()}
    for each in sorted(folder.iterdir()):
        if each.name not in (CONFIG, MODEL, TRAINING) and _NAME.fullmatch(each.name):
            files[each.name] = each.read_bytes()
    tensors = load_file(folder / MODEL)
    for name, content in files.items():
        tensors[f"{_FILE}{name}"] = torch.frombuffer(
            bytearray(content), dtype=torch.uint8
        )
    write_weights(path, tensors, metadata, fineness)
    return metadata


def unpack_checkpoint(path: Path, folder: Path) -> None:
    """Write the folder that lerobot reads.

    Args:
        path: File that :func:`pack_checkpoint` wrote.
        folder: Existing folder to write to.

    Raises:
        WeightsError: The file is damaged, or no checkpoint of LeRobot.
    """
    metadata = read_metadata(path)
    if not metadata.model.startswith(LEROBOT):
        raise WeightsError(
            f"{path} has weights of {metadata.model}, which is none of LeRobot's: "
            "leave out 'lerobot:'."
        )
    weights = {}
    try:
        with safe_open(path, "pt") as file:
            for name in file.keys():  # noqa: SIM118 - it is no mapping
                value = file.get_tensor(name)
                if name.startswith(_FILE):
                    _write(folder, name.removeprefix(_FILE), value)
                elif name in metadata.packed:
                    weights[name] = unpack(value, metadata.packed[name])
                else:
                    weights[name] = (
                        value.float() if value.is_floating_point() else value
                    )
    except (SafetensorError, PackingError, OSError, ValueError) as error:
        raise WeightsError(f"{path} is damaged: {error}. Fetch it again.") from error
    save_file(weights, folder / MODEL)


def _write(folder: Path, name: str, content: torch.Tensor) -> None:
    """Write a file of a checkpoint.

    Raises:
        ValueError: It would be none of this folder.
    """
    if not _NAME.fullmatch(name) or content.dtype != torch.uint8:
        raise ValueError(f"{name!r} is no file of a checkpoint")
    (folder / name).write_bytes(np.asarray(content).tobytes())


@contextmanager
def checkpoint_folder(name: str) -> Iterator[str]:
    """Give what lerobot reads: published weights are unpacked meanwhile.

    Args:
        name: Name of published weights; or a folder or a repository of the Hub, which
            is returned as it is.

    Raises:
        WeightsError: There is nothing of that name, or published weights are missing or
            damaged.
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
    with TemporaryDirectory() as folder:
        unpack_checkpoint(find_published(name), Path(folder))
        yield folder
