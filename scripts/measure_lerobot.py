r"""Measure the time to read and to assemble LeRobotDatasets, on an export.

In an environment with lerobot:

    lemma generate --tasks pass --split val --episodes 10 --out data/few
    lemma render data/few --form lerobot --size 160x120 --no-depth \
        --environment-state sentence --out data/few-videos
    python scripts/measure_lerobot.py data/few-videos --copies 289

One process reads samples with two cameras and a chunk of 20 actions, as for ACT. The
assembly uses copies of the data set as shards.
"""

import argparse
import tempfile
from importlib import import_module
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from lemma.core.workers.pool import ProcessPool
from lemma.dataset.lerobot.aggregate import aggregate_in_groups, silence
from lerobot_train_unpacked import read_unpacked, unpack

CHUNK = 20
SAMPLES, SAMPLES_UNPACKED = 100, 2_000


def reading_ms(dataset: Any, samples: int) -> float:
    """Return the CPU time of a sample [ms]."""
    drawn = np.random.default_rng(0).integers(len(dataset), size=samples)
    dataset[0]
    begin = process_time()
    for index in drawn:
        dataset[int(index)]
    return 1e3 * (process_time() - begin) / samples


def measure_reading(root: Path) -> tuple[float, float]:
    """Return the CPU time of a sample with lerobot's reader and unpacked [ms]."""
    module = import_module("lerobot.datasets.lerobot_dataset")
    import_module("torch").set_num_threads(1)
    fps = module.LeRobotDataset("lemma/x", root=root).meta.fps
    options: dict[str, Any] = {
        "root": root,
        "video_backend": "pyav",
        "return_uint8": True,
        "delta_timestamps": {"action": [step / fps for step in range(CHUNK)]},
    }
    own = reading_ms(module.LeRobotDataset("lemma/x", **options), SAMPLES)
    with tempfile.TemporaryDirectory() as folder:
        unpack(root, Path(folder), ProcessPool())
        read_unpacked(Path(folder))
        dataset = module.LeRobotDataset("lemma/x", **options)
        return own, reading_ms(dataset, SAMPLES_UNPACKED)


def measure_assembly(root: Path, copies: int, workers: int | None) -> float:
    """Return the time to assemble copies of a data set [s]."""
    with tempfile.TemporaryDirectory() as folder:
        links = [Path(folder, f"{number:06d}") for number in range(copies)]
        for link in links:
            link.symlink_to(root.absolute())
        begin = perf_counter()
        aggregate_in_groups(links, Path(folder, "whole"), ProcessPool(workers))
        return perf_counter() - begin


def main() -> None:
    """Measure, and print the times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("root", type=Path)
    parser.add_argument("--copies", type=int, default=289)
    parser.add_argument("--workers", type=int)
    args = parser.parse_args()
    silence()
    own, without = measure_reading(args.root)
    print(f"a sample: {own:.1f} ms by lerobot, {without:.2f} ms unpacked")
    took_s = measure_assembly(args.root, args.copies, args.workers)
    print(f"{args.copies} of them became one in {took_s:.0f} s")


if __name__ == "__main__":
    main()
