"""Distributed training, with one process per GPU."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor
from torch import distributed as dist

from lemma.core.errors import InvalidConfigError
from lemma.policies.batch import check_gpu


@dataclass(frozen=True)
class ProcessGroup:
    """Rank of this process, number of processes, and device."""

    rank: int
    count: int
    device: torch.device
    talk: dist.ProcessGroup | None = None
    """The process group for tensors on the CPU, besides that of the GPUs."""

    @property
    def first(self) -> bool:
        """Whether this process writes and reports: rank 0."""
        return self.rank == 0

    def agree(self, *values: float) -> tuple[float, ...]:
        """Broadcast values from the first process."""
        if self.count == 1:
            return values
        tensor = torch.tensor(values, dtype=torch.float64)
        dist.broadcast(tensor, 0, group=self.talk)
        return tuple(tensor.tolist())

    def total(self, values: Tensor) -> Tensor:
        """Return the sum over all processes, on the CPU."""
        values = values.cpu()
        if self.count > 1:
            dist.all_reduce(values, group=self.talk)
        return values


@contextmanager
def processes(device: str = "auto") -> Iterator[ProcessGroup]:
    """Join the process group that ``torchrun`` started; one process without it.

    Args:
        device: ``"auto"``, ``"cuda"`` or ``"cpu"``.

    Raises:
        InvalidConfigError: ``"cuda"`` without a GPU; or the environment has several
            processes, but lacks variables that torchrun sets.
    """
    count = _variable("WORLD_SIZE", 1)
    chosen = _device(device)
    if count == 1:
        yield ProcessGroup(0, 1, chosen)
        return
    _check_torchrun(count)
    dist.init_process_group("nccl" if chosen.type == "cuda" else "gloo")
    talk = dist.new_group(backend="gloo")
    try:
        yield ProcessGroup(dist.get_rank(), count, chosen, talk)
    finally:
        dist.destroy_process_group()


def _variable(name: str, default: int, most: int = 2**20) -> int:
    """Return an environment variable as a whole number; the default if it is empty.

    Raises:
        InvalidConfigError: It is no whole number in range.
    """
    text = os.environ.get(name, "").strip() or str(default)
    if not (text.isdecimal() and text.isascii() and default <= int(text) < most):
        raise InvalidConfigError(
            f"The environment variable {name} is {text!r}, which is no number of "
            f"processes. Start several with torchrun, or one without it: unset {name}."
        )
    return int(text)


def _check_torchrun(count: int) -> None:
    """Check the environment variables that torchrun sets.

    Raises:
        InvalidConfigError: One is missing, or the rank is too large.
    """
    needed = ("RANK", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT")
    missing = [name for name in needed if not os.environ.get(name, "").strip()]
    if missing or _variable("RANK", 0) >= count:
        wrong = f"{', '.join(missing)} missing" if missing else "RANK too large"
        raise InvalidConfigError(
            f"The environment has WORLD_SIZE={count}, for distributed training, but "
            f"with {wrong}. Start the processes with torchrun, or train in one "
            "process: env -u WORLD_SIZE lemma train ..."
        )
    _variable("MASTER_PORT", 0, 2**16)


def _device(name: str) -> torch.device:
    if name == "cuda":
        check_gpu()
    if name == "cpu" or not torch.cuda.is_available():
        return torch.device("cpu")
    # Batches of episodes differ in size, which fragments memory without this setting.
    os.environ.setdefault("PYTORCH_CUDA_ALLOC_CONF", "expandable_segments:True")
    index = _variable("LOCAL_RANK", 0)
    if index >= torch.cuda.device_count():
        raise InvalidConfigError(
            f"The environment has LOCAL_RANK={index}, but this machine has "
            f"{torch.cuda.device_count()} GPU. Start as many processes as it has."
        )
    device = torch.device("cuda", index)
    torch.cuda.set_device(device)
    return device
