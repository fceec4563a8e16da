"""M-CLIPort decides robot, primitive, stop and poses from the instruction alone."""

import math
from dataclasses import replace

import pytest
import torch
from batches import (
    TINY_STREAMS,
    drawn_batch,
    gradients,
    inputs_of,
    labels_of,
    learn_by_heart,
    part_of,
    total,
)

from lemma.policies.batch import PRIMITIVES, STOP
from lemma.policies.interfaces import Policy
from lemma.policies.models.cliport.model import MCLIPort, MCLIPortConfig
from lemma.tasks.subtask import Primitive

TINY = MCLIPortConfig(**TINY_STREAMS)


def tiny() -> MCLIPort:
    torch.manual_seed(0)
    return MCLIPort(TINY)


@pytest.mark.slow
def test_it_learns_an_episode_by_heart() -> None:
    batch = drawn_batch(4)
    decision = labels_of(batch).decision.clone()
    decision[1, 1] = PRIMITIVES.index("poke")
    batch = replace(batch, labels=replace(labels_of(batch), decision=decision))
    model = tiny()
    learn_by_heart(model, batch, 180)
    scores = model.score(batch)
    assert scores["right_stop"].tolist() == [1.0] * 4
    assert scores["right_robot"][:3].tolist() == [1.0] * 3
    assert scores["right_primitive"][:3].tolist() == [1.0] * 3
    assert scores["decided"][3] == 1.0
    found = model.act(inputs_of(batch))
    assert [d.subtask.robot for d in found] == ["robot_0", "robot_1", "robot_0", ""]
    assert [d.subtask.primitive for d in found] == [
        Primitive.MOVE,
        Primitive.POKE,
        Primitive.MOVE,
        Primitive.STOP,
    ]
    assert found[3].grounded is None
    for decision_found, pick in zip(
        found[:3], labels_of(batch).pick_pose.tolist(), strict=False
    ):
        grounded = decision_found.grounded
        assert grounded is not None
        assert math.dist(grounded.pick.xy, pick[:2]) < 0.03
        assert grounded.primitive is decision_found.subtask.primitive


def test_every_weight_has_a_gradient_with_stop_in_the_batch() -> None:
    model = tiny()
    losses = model.loss(drawn_batch(3))
    assert all(value.isfinite() for value in losses.values())
    total(losses).backward()
    for name, gradient in gradients(model).items():
        assert gradient is not None, name
        assert gradient.isfinite().all(), name


def test_a_batch_of_stops_alone_is_fine() -> None:
    batch = part_of(drawn_batch(2), [1])
    losses = tiny().loss(batch)
    assert losses["stop"] > 0
    assert all(v == 0 for n, v in losses.items() if n != "stop")


def test_a_decision_does_not_depend_on_the_others() -> None:
    model = tiny()
    inputs = inputs_of(drawn_batch(5, stop_last=False))
    together, alone = model.act(inputs)[3], model.act(inputs[3:4])[0]
    assert together.subtask == alone.subtask
    if together.grounded and alone.grounded:
        assert math.dist(together.grounded.place.xy, alone.grounded.place.xy) < 1e-4
    assert model.act(inputs) == model.act(inputs)
    assert isinstance(model, Policy)


def test_a_wrong_stop_is_no_decision() -> None:
    batch = drawn_batch(2)
    model = tiny()
    last = model.stop[-1]
    assert isinstance(last, torch.nn.Linear)
    for value, expected in ((50.0, [0.0, 1.0]), (-50.0, [0.0, 0.0])):
        torch.nn.init.constant_(last.bias, value)
        scores = model.score(batch)
        assert scores["right_stop"].tolist() == (
            [0.0, 1.0] if value > 0 else [1.0, 0.0]
        )
        assert scores["decided"].tolist() == expected
    assert labels_of(batch).decision[1, 1] == STOP
