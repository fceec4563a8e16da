"""Measure the time to make and to read rendered data sets, and their size.

    python scripts/measure_dataset.py [--recipe DIR] [--episodes 10] [--seconds 5]

Without --recipe, it generates one for each number of workers up to the cores, with
--episodes of every task. Rendering is measured in one process. Reading is measured with
batches of 32 shuffled samples: in two processes that fill shared memory, in the two
threads of the package's own loader, in torch's DataLoader if torch is installed, and
per second of CPU time with samples stacked one by one. Files are read once before, so
that they are in the disk cache.
"""

import argparse
import json
import multiprocessing as mp
import tempfile
from importlib import import_module
from importlib.util import find_spec
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.bench.machine import describe_machine
from lemma.core.workers.pool import ProcessPool
from lemma.core.workers.resources import peak_memory_mb, usable_cores
from lemma.dataset.instructions import Language
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.dataset import (
    CAMERA_COLUMNS,
    MAP_COLUMNS,
    POLICY_COLUMNS,
    KeyframeDataset,
    MapsInMemory,
)
from lemma.dataset.rendered.render import RenderConfig, render

BATCH = 32
WORKERS = 2
SLOTS = 2 * WORKERS
SPLIT = "val"


def generation(folder: Path, episodes: int) -> dict[str, Any]:
    """Return rates and memory for 1, 2, 4, ... workers, up to the cores."""
    figures: dict[str, Any] = {}
    cores = usable_cores()
    powers = (2**power for power in range(cores.bit_length()))
    for workers in sorted({*powers, cores}):
        out = folder / f"recipe-{workers}"
        order = GenerateConfig(out=out, splits=(SPLIT,), episodes=episodes)
        made = generate(order, ProcessPool(workers))
        rate = made.made / made.seconds
        figures[f"episodes_per_s_{workers}_workers"] = round(rate, 2)
        figures[f"worker_peak_mb_{workers}_workers"] = round(made.worker_mb)
    return figures


def measure(recipe: Path, folder: Path, seconds: float) -> dict[str, Any]:
    """Return all figures."""
    figures: dict[str, Any] = {"machine": describe_machine()}
    frames = folder / "keyframes"
    # A warm-up: the first images include compilation and start-up.
    (first, *_) = RenderConfig(recipe=recipe, out=frames).groups()
    warm = RenderConfig(recipe=recipe, out=frames, tasks=(first[0].stem,))
    before = render(warm, KeyframeForm(), ProcessPool(1))
    every = RenderConfig(recipe=recipe, out=frames)
    made = render(every, KeyframeForm(), ProcessPool(1))
    counted = made.rows - before.rows
    figures["keyframes"] = made.rows
    figures["render_keyframes_per_s_and_core"] = round(counted / made.seconds, 1)
    figures["render_peak_mb"] = round(peak_memory_mb())
    for part in ("maps", "cameras"):
        size = sum(path.stat().st_size for path in (frames / part).rglob("*.arrow"))
        figures[f"{part}_kb_per_keyframe"] = round(size / made.rows / 1e3, 1)
    maps = KeyframeDataset(frames, SPLIT, columns=(*MAP_COLUMNS, *POLICY_COLUMNS))
    drawn = KeyframeDataset(
        frames,
        SPLIT,
        columns=(*MAP_COLUMNS, *POLICY_COLUMNS),
        language=Language(instructions="resampled"),
    )
    if find_spec("torch"):
        for workers in (0, WORKERS):
            rate = torch_rate(maps, workers, seconds)
            figures[f"map_samples_per_s_torch_{workers}_workers"] = round(rate)
    cameras = KeyframeDataset(frames, SPLIT, columns=CAMERA_COLUMNS)
    for name, dataset in (("map", maps), ("resampled", drawn), ("camera", cameras)):
        rate = read_rate(dataset, seconds)
        figures[f"{name}_samples_per_s_{WORKERS}_processes"] = round(rate)
        figures[f"{name}_samples_per_cpu_s"] = round(cpu_rate(dataset, seconds))
    start = perf_counter()
    memory = MapsInMemory.load(frames, SPLIT)
    figures["load_into_memory_per_s"] = round(len(memory) / (perf_counter() - start))
    figures["memory_bytes_per_keyframe"] = memory.nbytes // len(memory)
    figures["memory_samples_per_s"] = round(memory_rate(memory, seconds))
    return figures


def read_rate(dataset: KeyframeDataset, seconds: float) -> float:
    """Return samples per second of two workers that fill batches in shared memory."""
    spare = sum(v.nbytes for v in dataset[0].values() if isinstance(v, np.ndarray))
    shared = SharedMemory(create=True, size=SLOTS * BATCH * spare)
    context = mp.get_context("spawn")
    free, full = context.Queue(), context.Queue()
    workers = [
        context.Process(
            target=work, args=(dataset, shared.name, free, full, seed), daemon=True
        )
        for seed in range(WORKERS)
    ]
    for worker in workers:
        worker.start()
    try:
        for _ in workers:
            full.get()
        for slot in range(SLOTS):
            free.put(slot)
        start, batches = perf_counter(), 0
        while perf_counter() - start < seconds:
            free.put(full.get())
            batches += 1
        return batches * BATCH / (perf_counter() - start)
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()
        shared.close()
        shared.unlink()


def torch_rate(dataset: KeyframeDataset, workers: int, seconds: float) -> float:
    """Return samples per second of torch's loader, with a sampler of batches."""
    # A late import, because torch is optional.
    data = import_module("torch.utils.data")
    order = np.random.default_rng(0)
    # More batches than can be read, because a second epoch would restart the workers.
    count = int(1000 * seconds)
    batches = [order.integers(len(dataset), size=BATCH).tolist() for _ in range(count)]
    loader = iter(
        data.DataLoader(dataset, batch_size=None, sampler=batches, num_workers=workers)
    )
    for _ in range(SLOTS):
        next(loader)
    start, count = perf_counter(), 0
    while perf_counter() - start < seconds:
        count += len(next(loader)["instruction"])
    return count / (perf_counter() - start)


def cpu_rate(dataset: KeyframeDataset, seconds: float) -> float:
    """Return samples per second of CPU time.

    Samples are stacked one by one in new memory, as torch does by default.
    """
    order = np.random.default_rng(0)
    start, count = process_time(), 0
    while process_time() - start < seconds:
        picks = order.integers(len(dataset), size=BATCH)
        samples = [dataset[int(pick)] for pick in picks]
        for name in arrays_of(samples[0]):
            np.stack([sample[name] for sample in samples])
        count += len(samples)
    return count / (process_time() - start)


def arrays_of(sample: dict[str, Any]) -> list[str]:
    """Return the names of a sample's arrays."""
    return [name for name, value in sample.items() if isinstance(value, np.ndarray)]


def work(dataset: KeyframeDataset, name: str, free: Any, full: Any, seed: int) -> None:
    """Fill one batch after another, without end."""
    shared = SharedMemory(name)
    order = np.random.default_rng(seed)
    for index in range(len(dataset)):
        dataset[index]
    batches = [slot_arrays(dataset, shared, slot) for slot in range(SLOTS)]
    full.put(-1)
    while True:
        slot = free.get()
        dataset.batch(order.integers(len(dataset), size=BATCH), batches[slot])
        full.put(slot)


def slot_arrays(
    dataset: KeyframeDataset, shared: SharedMemory, slot: int
) -> dict[str, Any]:
    """Return a batch whose images are in shared memory."""
    batch = dataset.batch(range(BATCH))
    offset = slot * (shared.size // SLOTS)
    for name in arrays_of(dataset[0]):
        array: NDArray[Any] = np.ndarray(
            batch[name].shape, batch[name].dtype, shared.buf, offset
        )
        batch[name] = array
        offset += array.nbytes
    return batch


def memory_rate(memory: MapsInMemory, seconds: float) -> float:
    """Return samples per second of one process that gathers batches."""
    order = np.random.default_rng(0)
    start, batches = perf_counter(), 0
    while perf_counter() - start < seconds:
        picks = order.integers(len(memory), size=BATCH)
        _ = memory.rgb[picks], memory.height[picks]
        batches += 1
    return batches * BATCH / (perf_counter() - start)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", type=Path)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=5.0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder, source, figures = Path(scratch), arguments.recipe, {}
        if source is None:
            figures = generation(folder, arguments.episodes)
            source = folder / "recipe-1"
        figures = measure(source, folder, arguments.seconds) | figures
        print(json.dumps(figures, indent=1))
