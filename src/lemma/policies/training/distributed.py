"""Processes that train one model together, one for each GPU."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor
from torch import distributed as dist

from lemma.core.errors import InvalidConfigError


@dataclass(frozen=True)
class ProcessGroup:
    """Which of how many processes this one is, and its device."""

    rank: int
    count: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this is the one that writes and reports."""
        return self.rank == 0

    def agree(self, *values: float) -> tuple[float, ...]:
        """Return what the first process says, in all of them."""
        if self.count == 1:
            return values
        told = torch.tensor(values, dtype=torch.float64)
        dist.broadcast(told, 0, group=_Talk.group)
        return tuple(told.tolist())

    def total(self, values: Tensor) -> Tensor:
        """Return the sum over all processes, on the CPU."""
        values = values.cpu()
        if self.count > 1:
            dist.all_reduce(values, group=_Talk.group)
        return values


class _Talk:
    """The connection for what is on the CPU, beside that of the GPUs."""

    group: dist.ProcessGroup | None = None


@contextmanager
def processes(device: str = "auto") -> Iterator[ProcessGroup]:
    """Join the processes that ``torchrun`` started; alone, if it did not.

    Args:
        device: ``"auto"``, ``"cuda"`` or ``"cpu"``.

    Raises:
        InvalidConfigError: There is no GPU, and one was asked for.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    chosen = _device(device)
    if count == 1:
        yield ProcessGroup(0, 1, chosen)
        return
    dist.init_process_group("nccl" if chosen.type == "cuda" else "gloo")
    _Talk.group = dist.new_group(backend="gloo")
    try:
        yield ProcessGroup(dist.get_rank(), count, chosen)
    finally:
        _Talk.group = None
        dist.destroy_process_group()


def _device(name: str) -> torch.device:
    there = torch.cuda.is_available()
    if name == "cuda" and not there:
        raise InvalidConfigError(
            "No GPU can be used: torch finds no CUDA device. Leave out --device, or "
            "install a torch that is built for this machine's driver."
        )
    if name == "cpu" or not there:
        return torch.device("cpu")
    # Episodes differ in length, and with them batches: else memory falls to pieces.
    os.environ.setdefault("PYTORCH_CUDA_ALLOC_CONF", "expandable_segments:True")
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
    torch.cuda.set_device(device)
    return device
