"""The losses and gradients of a step as one CUDA graph.

A step of a small network has thousands of short kernels, and Python takes longer to
launch one than the GPU to run it. A captured step needs one launch.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from lemma.policies.batch import Batch

WARM_UP = 3
"""Steps before the capture, for libraries to choose and compile their kernels."""

_Record = TypeVar("_Record")


class CapturedStep:
    """Computes losses and gradients of batches that all have the same shapes."""

    def __init__(
        self, compute: Callable[[Batch], dict[str, Tensor]], batch: Batch
    ) -> None:
        """Capture the computation; the gradients of all weights are overwritten.

        Args:
            compute: Returns the losses of a batch, and sets the gradients of the
                weights. It must not use texts or names, nor synchronise with the CPU.
            batch: Any batch, with labels and ``text_tensors``.
        """
        self.batch = without_texts(batch, batch.text_tensors)
        device = batch.rgb.device
        beside = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
        beside.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(beside):
            for _ in range(WARM_UP):
                compute(self.batch)
        torch.cuda.current_stream(device).wait_stream(beside)
        self.graph = torch.cuda.CUDAGraph()
        # Thread-local, because another thread prepares batches during the capture.
        with torch.cuda.graph(self.graph, capture_error_mode="thread_local"):
            self.terms = compute(self.batch)

    def fits(self, batch: Batch) -> bool:
        """Return whether a batch has the captured shapes."""
        return _shapes(batch) == _shapes(self.batch)

    def __call__(self, batch: Batch) -> dict[str, Tensor]:
        """Return the losses of a batch, and set the gradients of the weights."""
        for own, new in zip(_tensors(self.batch), _tensors(batch), strict=True):
            own.copy_(new)
        self.graph.replay()
        # Clone, because the next step overwrites them.
        return {name: term.clone() for name, term in self.terms.items()}


def without_texts(batch: Batch, tensors: Mapping[str, Tensor]) -> Batch:
    """Return a copy of a batch without texts and names.

    Args:
        batch: Batch with labels.
        tensors: Texts and names, encoded by the model.
    """
    assert batch.labels is not None
    own = {name: value.clone() for name, value in tensors.items()}
    bare = replace(_bare(batch), lesson=None)
    return replace(bare, labels=_bare(batch.labels), text_tensors=own)


def _bare(record: _Record) -> _Record:
    changed: dict[str, Any] = {}
    for name, value in _values(record).items():
        if isinstance(value, Tensor):
            changed[name] = value.clone()
        elif isinstance(value, list):
            changed[name] = []
    return replace(record, **changed)  # type: ignore[type-var]


def _tensors(batch: Batch) -> list[Tensor]:
    values = [*_values(batch).values(), *_values(batch.labels).values()]
    found = [value for value in values if isinstance(value, Tensor)]
    return found + [batch.text_tensors[name] for name in sorted(batch.text_tensors)]


def _shapes(batch: Batch) -> list[torch.Size]:
    return [tensor.shape for tensor in _tensors(batch)]


def _values(record: Any) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in fields(record)}
