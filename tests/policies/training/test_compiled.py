"""The parts of a model that a GPU runs compiled: they are whole, and equal the rest."""

from functools import partialmethod

import pytest
import torch
from batches import batch_for
from tiers import slow_but
from tiny_models import OPTIONS

from lemma.policies.batch import Batch
from lemma.policies.layers import Network
from lemma.policies.models.base import Model
from lemma.policies.models.catalog import MODELS, make_model
from lemma.policies.training.step import compile_parts


@pytest.mark.filterwarnings("ignore:The .grad attribute:UserWarning")
@pytest.mark.parametrize("name", slow_but((*MODELS, "seen reach"), "reachnet"))
def test_compiled_parts_are_traced_whole_and_compute_the_same(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = OPTIONS.get(name, {})
    if name == "seen reach":
        # Losses reach perception through the candidates.
        name, options = "reachnet", {**OPTIONS["reachnet"], "reach": "demonstrations"}
    model = make_model(name, options).train()
    batch = batch_for(name)
    usual = _losses_and_gradients(model, batch)
    # The tracer of a GPU, without its code generator. It raises where it must stop.
    traced = partialmethod(Network.compile, backend="aot_eager", fullgraph=True)
    monkeypatch.setattr(Network, "compile", traced)
    torch.compiler.reset()
    compile_parts(model, False)
    found = _losses_and_gradients(model, batch)
    assert found == pytest.approx(usual, rel=1e-4, abs=1e-6)


def _losses_and_gradients(model: Model, batch: Batch) -> dict[str, float]:
    """Return the losses, and the norm of the gradient of each parameter."""
    model.zero_grad()
    torch.manual_seed(0)
    losses = model.loss(batch)
    torch.stack([*losses.values()]).sum().backward()
    found = {name: value.item() for name, value in losses.items()}
    for name, weight in model.named_parameters():
        found[name] = 0.0 if weight.grad is None else weight.grad.norm().item()
    return found
