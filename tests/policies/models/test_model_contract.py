"""The contract of models whose input is a map; key poses have tests of their own."""

import math
from collections.abc import Sequence
from typing import Any

import pytest
import torch
from batches import drawn_batch, gradients, inputs_of, part_of, total
from tiny_models import OPTIONS, tiny

from lemma.core.poses import Pose2
from lemma.policies.interfaces import Grounder, Planner, Policy, PolicyInput
from lemma.policies.models.base import MapModel
from lemma.policies.models.catalog import MODELS
from lemma.tasks.subtask import Primitive, SubTask

MOVE = SubTask("robot_1", Primitive.MOVE, "red_cube", "shared")
IDLE = dict.fromkeys(OPTIONS, ()) | {
    # No drag, and no stick that is laid down.
    "reachnet": ("grounding", "planner.numbers"),
    # No rules. The inherited count of conjuncts is not read.
    "team-reachnet": ("reader.own_color", "reader.role", "reader.count"),
}
"""Weights for what is not in the frames, by the beginnings of their names."""
every_model = pytest.mark.parametrize("name", OPTIONS)


def test_every_model_is_held_to_it() -> None:
    kinds = {name: MODELS[name][0] for name in MODELS}
    assert {*OPTIONS, "keypose"} == {
        name
        for name, kind in kinds.items()
        if issubclass(kind, MapModel) and kind.__module__.startswith("lemma.")
    }


@every_model
def test_losses_are_finite_and_train_every_weight(name: str) -> None:
    model = tiny(name)
    losses = model.loss(drawn_batch(4))
    assert all(term.isfinite() for term in losses.values())
    total(losses).backward()
    for weight, gradient in gradients(model).items():
        if not weight.startswith(IDLE[name]):
            assert gradient is not None, weight
            assert gradient.any(), weight
        assert gradient is None or gradient.isfinite().all(), weight
    stop = model.loss(drawn_batch(1))
    assert all(term.isfinite() for term in stop.values())


def decided(
    model: Any, given: Sequence[PolicyInput]
) -> list[tuple[SubTask | None, tuple[Pose2, ...]]]:
    """Return the sub-task, and the poses if any, of each input."""
    if isinstance(model, Policy):
        found = [(d.subtask, d.grounded) for d in model.act(given)]
    elif isinstance(model, Planner):
        found = [(subtask, None) for subtask in model.plan(given)]
    else:
        assert isinstance(model, Grounder)
        found = [(MOVE, g) for g in model.ground(given, [MOVE] * len(given))]
    return [(subtask, (g.pick, g.place) if g else ()) for subtask, g in found]


@every_model
def test_neither_company_nor_mode_changes_a_decision(name: str) -> None:
    model = tiny(name).train()
    given = inputs_of(drawn_batch(4, seed=3))
    together = decided(model, given)
    assert all(module.training for module in model.modules())
    assert decided(model.eval(), given) == together
    for one, (subtask, poses) in zip(given, together, strict=True):
        ((same, alone),) = decided(model, [one])
        assert same == subtask
        for pose, other in zip(alone, poses, strict=True):
            assert math.dist(pose.xy, other.xy) < 1e-4
            assert math.cos(pose.yaw - other.yaw) > 1 - 1e-6


@every_model
def test_company_does_not_change_a_score(name: str) -> None:
    model, batch = tiny(name).eval(), drawn_batch(4, seed=1)
    rows = [[i] for i in range(4)] if model.unit == "frame" else [[0, 1, 2, 3]]
    together = model.score(batch)
    assert len(together) > 1
    for some in rows:
        for score, values in model.score(part_of(batch, some)).items():
            torch.testing.assert_close(
                values, together[score][some], equal_nan=True, atol=1e-4, rtol=1e-4
            )
