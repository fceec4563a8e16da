r"""Publish a reader that was trained alone, as weights that build on others.

    python scripts/measure_reading.py --start reachnet --weights reader.pt ...
    python scripts/measure_refusals.py reachnet --reader reader.pt --fit
    python scripts/publish_reader.py reader.pt reachnet NAME --temperature 1.5 \
        --steps 4000 --command "python scripts/measure_reading.py ..."

The file holds the reader alone; all other tensors come from the weights that it builds
on, whose hash it has.
"""

import argparse
from dataclasses import asdict, replace
from pathlib import Path

import torch

from lemma.core.files import read_json, sha256_of, write_json
from lemma.policies.models.reachnet.goal_reader import GoalReader, ReaderConfig
from lemma.policies.weights import CHECKOUT, LIST, SUFFIX, find_weights, load_model
from lemma.policies.weights_file import in_16_bits, read_metadata, write_tensors
from publish_weights import Fineness, rounded

FINENESS = Fineness(coarse=20.0, fine=2048.0)
"""As ReachNet's."""


def main() -> None:
    """Publish."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reader", type=Path)
    parser.add_argument("base", help="published weights of ReachNet")
    parser.add_argument("name", help="name of the new ones")
    parser.add_argument("--temperature", type=float, default=1.0)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--command", required=True, help="the one that trained it")
    options = parser.parse_args()
    config = ReaderConfig(temperature=options.temperature)
    reader = GoalReader(config)
    reader.load_state_dict(torch.load(options.reader))
    weights = {f"reader.{name}": each for name, each in reader.state_dict().items()}
    base = find_weights(options.base)
    listed = read_json(CHECKOUT / LIST)
    about = read_metadata(base)
    tensors, packed = rounded(in_16_bits(weights), FINENESS)
    metadata = replace(
        about,
        options={**about.options, "reader": asdict(config)},
        command=options.command,
        scores={},
        training={},
        ended="steps",
        steps=options.steps,
        base=(options.base, listed[options.base]["sha256"]),
        packed=packed,
    )
    path = CHECKOUT / f"{options.name}{SUFFIX}"
    write_tensors(path, tensors, metadata)
    listed[options.name] = {
        "file": path.name,
        "sha256": sha256_of(path),
        "bytes": path.stat().st_size,
        "repository": None,
        "revision": None,
        "unpacked": {
            "sha256": sha256_of(options.reader),
            "bytes": options.reader.stat().st_size,
        },
        "fineness": asdict(FINENESS),
        "model": metadata.model,
        "data": metadata.data,
        "command": metadata.command,
        "ended": metadata.ended,
        "steps": metadata.steps,
        "scores": {},
        "lemma": metadata.lemma,
        "base": options.base,
    }
    write_json(CHECKOUT / LIST, listed)
    load_model(options.name)


if __name__ == "__main__":
    main()
