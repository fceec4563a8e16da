"""Concurrent commands, each with one GPU or none."""

import os
import subprocess
import sys
import time
from pathlib import Path

import torch

VISIBLE = "CUDA_VISIBLE_DEVICES"
"""Environment variable with the GPUs of a process."""


def visible_gpus() -> list[str]:
    """Return the names of the GPUs that this process may use.

    In a job of a cluster they may be a subset that does not begin with 0.
    """
    count = torch.cuda.device_count()
    visible = os.environ.get(VISIBLE)
    names = visible.split(",") if visible else [str(number) for number in range(count)]
    return [name.strip() for name in names[:count]]


def start(command: str, log: Path, gpu: int | None = None) -> "subprocess.Popen[bytes]":
    """Start a command of this environment, and append its output to a file.

    Args:
        command: Program and arguments.
        log: The file.
        gpu: Index into :func:`visible_gpus` of its GPU; None for no GPU.
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
