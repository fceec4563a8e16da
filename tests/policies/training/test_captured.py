"""A captured step on a GPU: all that decides whether it can be one is true on a CPU."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from batches import drawn_batch
from tiers import slow_but
from tiny_models import OPTIONS
from torch.utils._python_dispatch import TorchDispatchMode

from lemma.policies.models.catalog import MODELS, make_model
from lemma.policies.training.captured import without_texts

CAPTURED = tuple(
    name for name in MODELS if getattr(MODELS[name][0], "of_fixed_shape", False)
)
WAITS = {"lift_fresh", "_local_scalar_dense", "nonzero", "masked_select", "is_nonzero"}
"""Operations for which a GPU waits, or that bring numbers from the CPU."""


class Waits(TorchDispatchMode):
    """Counts the operations that a captured step must not have."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[str] = Counter()

    def __torch_dispatch__(
        self,
        func: Any,
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        name = func.overloadpacket.__name__
        masks = args[1] if name in ("index", "index_put", "index_put_") else ()
        masked = any(m is not None and m.dtype == torch.bool for m in masks)
        self.found[name] += name in WAITS or masked
        return func(*args, **(kwargs or {}))


def test_there_are_models_to_capture() -> None:
    assert {"reachnet", "cliport", "m-cliport"} <= set(CAPTURED)


@pytest.mark.parametrize("name", slow_but(CAPTURED, "reachnet"))
def test_the_loss_needs_no_text_and_waits_for_nothing(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = make_model(name, OPTIONS.get(name, {})).train()
    batch = drawn_batch(4)
    assert batch.labels is not None
    if name == "keypose":
        pose, last = torch.zeros(4, 3), torch.zeros(4, 2)
        labels = replace(batch.labels, pick_pose=pose, kind_and_height=last)
        batch = replace(batch, labels=labels)
    ready = without_texts(batch, model.text_tensors(batch))
    torch.manual_seed(0)
    usual = model.loss(batch)
    # On a CPU, and only there, it looks whether its numbers are in range.
    monkeypatch.setattr(torch.nn.functional, "one_hot", _one_hot)
    torch.manual_seed(0)
    with Waits() as waits:
        bare = model.loss(ready)
    assert {n: v.item() for n, v in bare.items()} == {
        n: v.item() for n, v in usual.items()
    }
    assert not +waits.found


def _one_hot(numbers: torch.Tensor, count: int) -> torch.Tensor:
    return (numbers[..., None] == torch.arange(count)).long()
