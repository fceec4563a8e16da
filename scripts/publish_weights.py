"""Pack weights for publication, check them, and upload them.

Run from the repository:

    python scripts/publish_weights.py pack runs/seed-0/reachnet reachnet --coarse 32
    lemma evaluate --policy reachnet --episodes 5 --out out/reachnet
    python scripts/publish_weights.py pack FOLDER act --coarse 32 --command "..."
    python scripts/publish_weights.py compare out/reachnet results/reachnet/seed-0.json
    python scripts/publish_weights.py upload OWNER/NAME

``pack`` quantises the weights of a training run, of ``lemma train`` or of LeRobot, into
``weights/``; ``compare`` compares a policy's decisions with earlier ones; ``upload``
pins the revision of the upload.

Quantisation steps are shares of a tensor's standard deviation. Poses depend on small
matrices and kernels, at the ends of a network and at its highest resolution, which have
finer steps. Kernels of many channels, which have most of the weights, process coarse
maps. Everything else stays in 16 bits.
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
"""Largest size of one file."""
NEAR_MM = 1.0
"""Poses this close count as equal; it is less than the servos' error."""
CONFIG, TRAINING = "config.json", "train_config.json"
"""Files of a LeRobot checkpoint with the options of policy and training."""
_LEAST = 1024
"""Tensors with fewer values, and vectors, are not quantised."""
_PLACES = ("pretrained_path", "device")
"""Entries of a configuration that depend on the machine."""
_SYMBOLS = ("robot", "primitive", "pick", "place", "outcome")


@dataclass(frozen=True)
class Fineness:
    """Options of the quantisation, as steps per standard deviation of a tensor."""

    coarse: float
    """Steps for large tensors; 32 give about 7 bits."""
    fine: float = 512.0
    """Steps for others; 512 give 11 bits, 2048 give 13."""
    small: int = 32_768
    """Tensors with fewer values do not count as large."""
    only: str = ""
    """Regular expression for the start of large tensors' names; any if empty."""


def pack(
    source: Path,
    name: str,
    fineness: Fineness,
    folder: Path = CHECKOUT,
    command: str = "",
) -> Path:
    """Add the weights of a training run to the published ones.

    Args:
        source: A file of weights in 16 bits, the folder of a run, or a LeRobot
            checkpoint, ``.../checkpoints/last/pretrained_model``.
        name: Name of the published weights.
        fineness: Options of the quantisation.
        folder: Folder of the published weights.
        command: The command that trained a LeRobot checkpoint.

    Returns:
        The file.

    Raises:
        WeightsError: The weights are missing, damaged or too large, or the command of a
            LeRobot checkpoint is missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}{SUFFIX}"
    if is_checkpoint(source):
        if not command:
            raise WeightsError(f"Name the training command of {source} with --command.")
        metadata = pack_checkpoint(source, path, command, fineness)
        source = source / MODEL
        with TemporaryDirectory() as there:
            unpack_checkpoint(path, Path(there))
    else:
        source = find_weights(str(source))
        metadata = read_metadata(source)
        if metadata.packed:
            raise WeightsError(f"{source} is packed already. Use a training's output.")
        write_packed(path, load_weights(source).state_dict(), metadata, fineness)
        load_weights(path)
    size = path.stat().st_size
    if size > LARGEST_MB * 1e6:
        path.unlink()
        raise WeightsError(
            f"{source} takes {size / 1e6:.1f} MB, and the limit of published weights "
            f"is {LARGEST_MB:.0f} MB. Use fewer steps, or train a smaller model."
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
    """Return tensors to write, and the quantisation of the packed ones.

    Args:
        weights: Tensors by name; only floating-point ones are quantised.
        fineness: Options of the quantisation.
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
    # Zigzag: small numbers of either sign become small unsigned ones.
    folded = ((numbers << 1) ^ (numbers >> 31)).astype(np.uint16)
    planes = (folded & 0xFF).astype(np.uint8), (folded >> 8).astype(np.uint8)
    # Low bytes are noise without repetitions; most high bytes are zero.
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
    """Write weights, quantised and packed, atomically.

    Args:
        path: The file.
        weights: A module's ``state_dict``.
        metadata: Metadata to write into it.
        fineness: Options of the quantisation.

    Raises:
        WeightsError: A value is not finite in 16 bits.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    tensors, packed = rounded(in_16_bits(weights), fineness)
    write_tensors(path, tensors, replace(metadata, packed=packed))


def is_checkpoint(folder: Path) -> bool:
    """Return whether a folder is a LeRobot checkpoint."""
    return (folder / CONFIG).is_file() and (folder / MODEL).is_file()


def pack_checkpoint(
    folder: Path, path: Path, command: str, fineness: Fineness
) -> WeightsMetadata:
    """Write a checkpoint into one file.

    Args:
        folder: ``.../checkpoints/last/pretrained_model``, or that of a number of steps.
        path: The file.
        command: Command line of its training.
        fineness: Options of the quantisation.

    Returns:
        The metadata of the file.

    Raises:
        WeightsError: A value is not finite in 16 bits, or the folder is not from
            lerobot-train.
        DatasetError: The folder is no checkpoint, the disk is full, or the folder of
            the file cannot be written to.
    """
    config, training = read_json(folder / CONFIG), read_json(folder / TRAINING)
    # The name of the parent folder is the number of steps; "last" is a link to one.
    above = folder.resolve().parent.name
    if not above.isdigit():
        raise WeightsError(
            f"The path {folder} lacks the number of steps. Use a folder that "
            "lerobot-train wrote: .../checkpoints/last/pretrained_model."
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
    """Return the differences of episodes in sub-tasks, outcomes and poses, as texts.

    Args:
        found: Folder of ``lemma evaluate``, or the file of a result with lines beside
            it.
        wanted: The same for the expected episodes, which include those of ``found``.
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
        repository: ``"owner/name"`` on the Hub, which is created if it is missing.
        folder: Folder of the published weights.

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
    """Run the command line."""
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
