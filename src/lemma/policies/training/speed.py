"""Measurement of training speed and GPU utilisation."""

import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice

import torch

from lemma.policies.models.base import Model
from lemma.policies.training.config import TrainingConfig
from lemma.policies.training.distributed import ProcessGroup, processes
from lemma.policies.training.loader import AHEAD, BatchLoader, Sampler
from lemma.policies.training.logging import gpu_memory_gb
from lemma.policies.training.run import (
    Data,
    first_model,
    read_frames,
    training_units,
)
from lemma.policies.training.step import Trainer

WARM_UP, STEPS = 8, 60
"""Numbers of warm-up steps, in which kernels are compiled and captured, and of measured
steps on a GPU."""
ON_CPU = 1, 3
"""Numbers of warm-up and of measured steps on a CPU, which takes seconds per frame."""
_FEW = 2
"""Number of frames, or episodes, in a batch on a CPU."""
_EVERY_MS = 100


def measure_training(config: TrainingConfig) -> dict[str, float]:
    """Measure some training steps; the weights are discarded.

    Args:
        config: Options of the training run.

    Returns:
        ``samples_per_s``; ``frames_per_s``; ``gpu_busy``, the share of the time in
        which a kernel ran, NaN without a GPU; ``gpu_memory_gb``; and ``start_s``, the
        time until the first measured step. With a GPU also ``eager_samples_per_s`` and
        ``eager_gpu_busy``, of steps that are neither compiled nor captured.
    """
    with processes(config.device) as team:
        begun = time.perf_counter()
        if team.device.type == "cuda":
            torch.backends.cudnn.benchmark = True
            torch.set_float32_matmul_precision("high")
        else:
            config = replace(config, batch_size=_FEW)
        config = config.resolved(1)
        model = first_model(config)
        data = read_frames(config, team, model.entities, mixed=model.of_any_team)
        found, start = _measure_steps(config, model, data, team)
        found["start_s"] = start - begun
        if team.device.type == "cuda":
            eager = replace(config, compile=False, capture=False)
            plain, _ = _measure_steps(eager, first_model(eager), data, team)
            for name in ("samples_per_s", "gpu_busy"):
                found[f"eager_{name}"] = plain[name]
        return found


def _measure_steps(
    config: TrainingConfig, model: Model, data: Data, team: ProcessGroup
) -> tuple[dict[str, float], float]:
    """Return the figures, and the time when the first measured step began [s]."""
    first, steps = (WARM_UP, STEPS) if team.device.type == "cuda" else ON_CPU
    units = training_units(model, data.train, config)
    order = Sampler(len(units), config.batch_size or 1, config.seed)
    trainer = Trainer(model, config, team)
    feed = BatchLoader(
        data.train,
        units,
        order,
        config,
        team.device,
        model=trainer.model,
    )
    frames = 0
    # The processes of the feed end while its last batches wait, which takes a second.
    with feed.ahead(0, first + steps + AHEAD + 1) as batches:
        for _ in range(first):
            trainer.train(next(batches), 0.0)
        _wait(team.device)
        start = time.perf_counter()
        with _busy(team.device) as busy:
            for batch in islice(batches, steps):
                trainer.train(batch, 0.0)
                frames += len(batch)
            _wait(team.device)
        seconds = time.perf_counter() - start
    found = {
        "samples_per_s": steps * (config.batch_size or 1) / seconds,
        "frames_per_s": frames / seconds,
        "gpu_busy": sum(busy) / len(busy) / 100.0 if busy else float("nan"),
        "gpu_memory_gb": gpu_memory_gb(),
    }
    return found, start


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


@contextmanager
def _busy(device: torch.device) -> Iterator[list[float]]:
    """Yield a list, to which samples of the GPU's utilisation [%] are added."""
    found: list[float] = []
    if device.type != "cuda":
        yield found
        return
    number = torch.cuda.get_device_properties(device).uuid
    words = ["--query-gpu=utilization.gpu", "--format=csv,noheader,nounits"]
    command = ["nvidia-smi", f"--id=GPU-{number}", *words, f"--loop-ms={_EVERY_MS}"]
    try:
        watcher = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    except OSError:
        yield found
        return

    def read() -> None:
        assert watcher.stdout is not None
        for line in watcher.stdout:
            if line.strip().isdigit():
                found.append(float(line))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield found
    finally:
        watcher.terminate()
        reader.join(5.0)
