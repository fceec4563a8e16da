"""Add weights to those that are published, check them, and upload them.

Run from the repository:

    python scripts/publish_weights.py pack runs/seed-0/reachnet reachnet --coarse 32
    lemma evaluate --policy reachnet --episodes 5 --out out/reachnet
    python scripts/publish_weights.py pack FOLDER act --coarse 32 --command "..."
    python scripts/publish_weights.py compare out/reachnet results/reachnet/seed-0.json
    python scripts/publish_weights.py upload OWNER/NAME

``pack`` rounds the weights of a training run, of ``lemma train`` or of LeRobot, into
``weights/``; ``compare`` tells whether a policy still does what it did before;
``upload`` pins what it uploads by its revision.

Steps of the rounding are shares of a tensor's standard deviation. Poses hang on small
matrices and kernels, at the ends of a network and at its highest resolution, which are
rounded more finely; kernels of many channels, which hold most of the weights, see
coarse maps. Everything else stays in 16 bits.
"""

import argparse
import json
import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch import Tensor

from lemma.core.errors import WeightsError
from lemma.core.files import read_json, sha256_of, write_json
from lemma.evaluation.lines import lines_at, read_lines
from lemma.evaluation.records import key_of
from lemma.policies.class_path import LEROBOT
from lemma.policies.control.checkpoint_file import (
    FILE,
    FILE_NAME,
    MODEL,
    unpack_checkpoint,
)
from lemma.policies.weights import CHECKOUT, LIST, SUFFIX, find_weights
from lemma.policies.weights_file import (
    LARGEST_MULTIPLE,
    TIME_LIMIT,
    Rounding,
    WeightsMetadata,
    in_16_bits,
    load_weights,
    read_metadata,
    write_tensors,
)

LARGEST_MB = 17.0
"""Of one file."""
NEAR_MM = 1.0
"""Poses this close are the same: less than the servos' error."""
CONFIG, TRAINING = "config.json", "train_config.json"
"""Files of a checkpoint of LeRobot: of its policy, and of its training."""
_LEAST = 1024
"""Tensors with fewer values, and vectors, are not rounded."""
_PLACES = ("pretrained_path", "device")
"""Entries of a configuration that hold places of the machine."""
_SYMBOLS = ("robot", "primitive", "pick", "place", "outcome")


@dataclass(frozen=True)
class Fineness:
    """How finely a model is rounded: in steps in a tensor's standard deviation."""

    coarse: float
    """Steps of large tensors; 32 make about 7 bits."""
    fine: float = 512.0
    """Steps of others; 512 make 11 bits, 2048 make 13."""
    small: int = 32_768
    """Tensors with fewer values are none of the large ones."""
    only: str = ""
    """Expression that the names of large ones begin with; any if empty."""


def pack(
    source: Path,
    name: str,
    fineness: Fineness,
    folder: Path = CHECKOUT,
    command: str = "",
) -> Path:
    """Add the weights of a training run to those that are published.

    Args:
        source: A file of weights in 16 bits, the folder of a run, or a checkpoint of
            LeRobot, ``.../checkpoints/last/pretrained_model``.
        name: Their new name.
        fineness: How finely they are rounded.
        folder: Where published weights lie.
        command: The command that trained a checkpoint of LeRobot.

    Returns:
        The file.

    Raises:
        WeightsError: They are missing, damaged or too large, or nobody says what
            trained them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}{SUFFIX}"
    if is_checkpoint(source):
        if not command:
            raise WeightsError(f"Say with --command what trained {source}.")
        metadata = pack_checkpoint(source, path, command, fineness)
        source = source / MODEL
        with TemporaryDirectory() as there:
            unpack_checkpoint(path, Path(there))
    else:
        source = find_weights(str(source))
        metadata = read_metadata(source)
        if metadata.packed:
            raise WeightsError(f"{source} is packed already. Take what training wrote.")
        write_packed(path, load_weights(source).state_dict(), metadata, fineness)
        load_weights(path)
    size = path.stat().st_size
    if size > LARGEST_MB * 1e6:
        path.unlink()
        raise WeightsError(
            f"{source} takes {size / 1e6:.1f} MB; at most {LARGEST_MB:.0f} MB are "
            "published. Take fewer steps, or train a smaller model."
        )
    listed = read_json(folder / LIST) if (folder / LIST).exists() else {}
    listed[name] = {
        "file": path.name,
        "sha256": sha256_of(path),
        "bytes": size,
        "repository": None,
        "revision": None,
        "unpacked": {"sha256": sha256_of(source), "bytes": source.stat().st_size},
        "fineness": asdict(fineness),
        "model": metadata.model,
        "data": metadata.data,
        "command": metadata.command,
        "ended": metadata.ended,
        "steps": metadata.steps,
        "scores": metadata.scores,
        "lemma": metadata.lemma,
    }
    write_json(folder / LIST, listed)
    return path


def rounded(
    weights: Mapping[str, Tensor], fineness: Fineness
) -> tuple[dict[str, Tensor], dict[str, Rounding]]:
    """Return tensors to be written, and how those that are packed were rounded.

    Args:
        weights: By name; floating-point ones are rounded.
        fineness: How finely.
    """
    packed, roundings = {}, {}
    for name, value in weights.items():
        if not value.is_floating_point() or value.ndim < 2 or value.numel() < _LEAST:
            packed[name] = value.half() if value.is_floating_point() else value
            continue
        exact = value.double()
        large = value.numel() >= fineness.small and re.match(fineness.only, name)
        steps = fineness.coarse if large else fineness.fine
        step = max(
            float(exact.std()) / steps, float(exact.abs().max()) / LARGEST_MULTIPLE
        )
        if not 0.0 < step < math.inf:
            packed[name] = value.half()
            continue
        numbers = torch.round(exact / step).to(torch.int32).numpy()
        packed[name] = torch.frombuffer(_coded(numbers.reshape(-1)), dtype=torch.uint8)
        roundings[name] = Rounding(tuple(value.shape), step)
    return packed, roundings


def _coded(numbers: NDArray[np.int32]) -> bytearray:
    """Return whole numbers of 16 bits as a Huffman code of their bytes."""
    # Small numbers of either sign become small ones without: 0, -1, 1, -2, 2 ...
    folded = ((numbers << 1) ^ (numbers >> 31)).astype(np.uint16)
    planes = (folded & 0xFF).astype(np.uint8), (folded >> 8).astype(np.uint8)
    # Low bytes are noise, for which matches are not searched; most high ones are zero.
    strategies = zlib.Z_HUFFMAN_ONLY, zlib.Z_DEFAULT_STRATEGY
    coded = bytearray()
    for plane, strategy in zip(planes, strategies, strict=True):
        coder = zlib.compressobj(9, zlib.DEFLATED, 15, 9, strategy)
        coded += coder.compress(plane.tobytes()) + coder.flush()
    return coded


def write_packed(
    path: Path,
    weights: Mapping[str, Tensor],
    metadata: WeightsMetadata,
    fineness: Fineness,
) -> None:
    """Write weights, rounded and packed, whole or not at all.

    Args:
        path: The file.
        weights: By name, as a module's ``state_dict`` has them.
        metadata: Metadata to write into it.
        fineness: How finely they are rounded.

    Raises:
        WeightsError: One does not fit into 16 bits.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    tensors, packed = rounded(in_16_bits(weights), fineness)
    write_tensors(path, tensors, replace(metadata, packed=packed))


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
        if each.name not in (CONFIG, MODEL, TRAINING) and FILE_NAME.fullmatch(
            each.name
        ):
            files[each.name] = each.read_bytes()
    tensors = load_file(folder / MODEL)
    for name, content in files.items():
        tensors[f"{FILE}{name}"] = torch.frombuffer(
            bytearray(content), dtype=torch.uint8
        )
    write_packed(path, tensors, metadata, fineness)
    return metadata


def compare(found: Path, wanted: Path) -> list[str]:
    """Return where episodes differ: other sub-tasks, another end, other poses.

    Args:
        found: Folder that ``lemma evaluate`` wrote, or the file of a result with lines
            beside it.
        wanted: The same; all of ``found`` must be in it.
    """
    problems = []
    now, before = (
        {key_of(row): row for row in read_lines(lines_at(path))}
        for path in (found, wanted)
    )
    largest_mm = 0.0
    for key, line in now.items():
        there = before[key]
        steps, other_steps = (
            [{s: step[s] for s in _SYMBOLS} for step in one["subtasks"]]
            for one in (line, there)
        )
        if steps != other_steps or line["success"] != there["success"]:
            problems.append(f"{key}: other sub-tasks, or another end")
            continue
        for step, other in zip(line["subtasks"], there["subtasks"], strict=True):
            if bool(step["grounded"]) != bool(other["grounded"]):
                problems.append(f"{key}: a pose of one alone")
            elif step["grounded"]:
                apart_mm = _apart_mm(step["grounded"], other["grounded"])
                largest_mm = max(largest_mm, apart_mm)
                if apart_mm > NEAR_MM:
                    problems.append(f"{key}: a pose is {apart_mm:.2f} mm off")
    print(
        f"{len(now)} episodes, {len(problems)} differences; "
        f"poses differ by at most {largest_mm:.3f} mm"
    )
    return problems


def _apart_mm(one: dict[str, list[float]], other: dict[str, list[float]]) -> float:
    """Return the larger distance of two pick and two place poses [mm]."""
    return 1000.0 * max(
        math.dist(one[pose][:2], other[pose][:2]) for pose in ("pick", "place")
    )


def upload(repository: str, folder: Path = CHECKOUT) -> str:
    """Upload all published weights, and pin their revision in the list.

    Args:
        repository: ``"owner/name"`` of the Hub; made if there is none.
        folder: Where published weights lie.

    Returns:
        The revision.
    """
    client = import_module("huggingface_hub").HfApi(library_name="lemma-bench")
    client.create_repo(repository, exist_ok=True)
    done = client.upload_folder(
        repo_id=repository, folder_path=folder, allow_patterns=[f"*{SUFFIX}", LIST]
    )
    revision = str(done.oid)
    pinned = {"repository": repository, "revision": revision}
    listed = read_json(folder / LIST)
    write_json(folder / LIST, {name: {**listed[name], **pinned} for name in listed})
    return revision


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description="Weights to be published.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    packing = verbs.add_parser("pack", help="round and list the weights of a run")
    packing.add_argument("source", type=Path)
    packing.add_argument("name")
    packing.add_argument("--coarse", type=float, required=True)
    packing.add_argument("--fine", type=float, default=Fineness.fine)
    packing.add_argument("--small", type=int, default=Fineness.small)
    packing.add_argument("--only", default=Fineness.only)
    packing.add_argument("--command", default="", help="what trained a LeRobot policy")
    comparing = verbs.add_parser("compare", help="compare the lines of two evaluations")
    comparing.add_argument("found", type=Path)
    comparing.add_argument("wanted", type=Path)
    verbs.add_parser("upload", help="upload and pin").add_argument("repository")
    asked = parser.parse_args()
    if asked.verb == "pack":
        fineness = Fineness(asked.coarse, asked.fine, asked.small, asked.only)
        print(pack(asked.source, asked.name, fineness, command=asked.command))
    elif asked.verb == "upload":
        print(upload(asked.repository))
    elif problems := compare(asked.found, asked.wanted):
        raise SystemExit("\n".join(problems))


if __name__ == "__main__":
    main()
