"""Add weights to those that are published, check them, and upload them.

Run from the repository:

    python scripts/publish_weights.py pack runs/seed-0/reachnet reachnet --coarse 32
    lemma evaluate --policy reachnet --episodes 5 --out out/reachnet
    python scripts/publish_weights.py pack FOLDER act --coarse 32 --command "..."
    python scripts/publish_weights.py compare out/reachnet results/reachnet/seed-0.json
    python scripts/publish_weights.py upload OWNER/NAME

``pack`` rounds the weights of a training run, of ``lemma train`` or of LeRobot, into
``weights/``; ``compare`` tells
whether a policy still does what it did before; ``upload`` pins what it uploads by its
revision.
"""

import argparse
import math
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from lemma.core.errors import WeightsError
from lemma.core.files import read_json, sha256_of, write_json
from lemma.evaluation.lines import lines_at, read_lines
from lemma.evaluation.records import key_of
from lemma.policies.control.checkpoint_file import (
    MODEL,
    is_checkpoint,
    pack_checkpoint,
    unpack_checkpoint,
)
from lemma.policies.packing import Fineness
from lemma.policies.weights import CHECKOUT, LIST, SUFFIX, find_weights
from lemma.policies.weights_file import (
    load_weights,
    read_metadata,
    write_weights,
)

LARGEST_MB = 17.0
"""Of one file."""
NEAR_MM = 1.0
"""Poses this close are the same: less than the servos' error."""
_SYMBOLS = ("robot", "primitive", "pick", "place", "outcome")


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
        write_weights(path, load_weights(source).state_dict(), metadata, fineness)
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
        told, said = (
            [{s: step[s] for s in _SYMBOLS} for step in one["subtasks"]]
            for one in (line, there)
        )
        if told != said or line["success"] != there["success"]:
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
