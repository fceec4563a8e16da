"""The parts of a model that a GPU runs compiled: they are whole, and equal the rest."""

from dataclasses import replace
from functools import partialmethod

import pytest
import torch
from batches import drawn_batch
from tiers import slow_but
from tiny_models import OPTIONS

from lemma.policies.layers import Network
from lemma.policies.models.catalog import MODELS, make_model
from lemma.policies.training.step import compile_parts


@pytest.mark.filterwarnings("ignore:The .grad attribute:UserWarning")
@pytest.mark.parametrize("name", slow_but(MODELS, "reachnet"))
def test_compiled_parts_are_traced_whole_and_compute_the_same(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = make_model(name, OPTIONS.get(name, {})).train()
    batch = drawn_batch(4)
    assert batch.labels is not None
    if name == "keypose":
        pose, last = torch.zeros(4, 3), torch.zeros(4, 2)
        labels = replace(batch.labels, pick_pose=pose, kind_and_height=last)
        batch = replace(batch, labels=labels)
    torch.manual_seed(0)
    usual = model.loss(batch)
    # The tracer of a GPU, without its code generator. It raises where it must stop.
    traced = partialmethod(Network.compile, backend="aot_eager", fullgraph=True)
    monkeypatch.setattr(Network, "compile", traced)
    torch.compiler.reset()
    compile_parts(model, False)
    torch.manual_seed(0)
    found = model.loss(batch)
    assert {n: v.item() for n, v in found.items()} == pytest.approx(
        {n: v.item() for n, v in usual.items()}, rel=1e-5
    )
