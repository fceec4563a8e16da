"""A captured step on a GPU: all that decides whether it can be one is true on a CPU."""

from collections import Counter
from typing import Any

import pytest
import torch
from batches import batch_for
from operations import Operations
from tiers import slow_but
from tiny_models import OPTIONS

from lemma.policies.models.catalog import MODELS, make_model
from lemma.policies.training.captured import without_texts

CAPTURED = tuple(
    name for name in MODELS if getattr(MODELS[name][0], "of_fixed_shape", False)
)
WAITS = {"lift_fresh", "_local_scalar_dense", "nonzero", "masked_select", "is_nonzero"}
"""Operations for which a GPU waits, or that bring numbers from the CPU."""


class Waits(Operations):
    """Counts the operations that a captured step must not have."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[str] = Counter()

    def look(self, name: str, args: tuple[Any, ...]) -> None:
        masks = args[1] if name in ("index", "index_put", "index_put_") else ()
        masked = any(m is not None and m.dtype == torch.bool for m in masks)
        self.found[name] += name in WAITS or masked


def test_there_are_models_to_capture() -> None:
    assert {"reachnet", "cliport", "m-cliport"} <= set(CAPTURED)


@pytest.mark.parametrize("name", slow_but(CAPTURED, "reachnet"))
def test_the_loss_needs_no_text_and_waits_for_nothing(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = make_model(name, OPTIONS.get(name, {})).train()
    batch = batch_for(name)
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
