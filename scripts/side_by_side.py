"""Commands that go on side by side, each with one GPU, or with none."""

import os
import subprocess
import sys
import time
from pathlib import Path

import torch

VISIBLE = "CUDA_VISIBLE_DEVICES"
"""Environment variable that names the GPUs which a process may use."""


def visible_gpus() -> list[str]:
    """Return the names of the GPUs that this process may use.

    A job of a cluster may use some of a machine: their names do not begin with 0 then.
    """
    count = torch.cuda.device_count()
    visible = os.environ.get(VISIBLE)
    names = visible.split(",") if visible else [str(number) for number in range(count)]
    return [name.strip() for name in names[:count]]


def start(command: str, log: Path, gpu: int | None = None) -> "subprocess.Popen[bytes]":
    """Start a command of this environment; what it says is added to a file.

    Args:
        command: Program and words.
        log: The file.
        gpu: Number of the one GPU that it sees, among :func:`visible_gpus`; it sees
            none without.
    """
    print(f"{time.strftime('%X')} {command}", flush=True)
    log.parent.mkdir(parents=True, exist_ok=True)
    program, *words = command.split()
    gpus = visible_gpus()
    seen = "" if gpu is None or not gpus else gpus[gpu]
    with log.open("ab") as output:
        return subprocess.Popen(
            [str(Path(sys.executable).with_name(program)), *words],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, VISIBLE: seen},
        )
