"""Learned policies learn to name what somebody else registered."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
from batches import drawn_batch, gradients, labels_of, total
from own_plugins import loaded
from tiny_models import tiny
from torch import Tensor

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.policies.batch import Batch
from lemma.policies.entities import BENCHMARK, EntitySet, poses_of
from lemma.policies.models.episodic_transformer import (
    EpisodicTransformer,
    EpisodicTransformerConfig,
)
from lemma.policies.models.reachnet.planner import (
    decision_of,
    number_of,
)
from lemma.policies.training.recoloring import permute_colors
from lemma.scene.objects.entity import ENTITIES
from lemma.scene.objects.kind import OBJECT_KINDS, cylinder

TINS = tuple(name.replace("cube", "tin") for name in ENTITIES if "cube" in name)


@pytest.fixture
def entities() -> Iterator[EntitySet]:
    with loaded():
        OBJECT_KINDS.add("tin", cylinder("tin", 0.03, 0.07, 0.1, drag_m=0.03))
        yield EntitySet.of((*ENTITIES, *TINS))


def with_tins(batch: Batch, entities: EntitySet) -> Batch:
    """Return a batch in which every cube is a tin."""

    def renamed(name: str) -> str:
        return name.replace("cube", "tin")

    new = [entities.number(renamed(name)) for name in BENCHMARK.places]
    lookup = torch.tensor([*new, -1])

    def numbers(decisions: Tensor) -> Tensor:
        return torch.cat([decisions[..., :2], lookup[decisions[..., 2:]]], -1)

    labels = labels_of(batch)
    recorded = [renamed(name) for name in BENCHMARK.names]
    objects = poses_of(labels.objects.numpy(), recorded, entities)
    return replace(
        batch,
        entities=entities,
        past=numbers(batch.past),
        labels=replace(
            labels,
            decision=numbers(labels.decision),
            objects=torch.from_numpy(objects).float(),
            heavy=torch.zeros(objects.shape[:2], dtype=torch.bool),
            goals=[
                tuple((renamed(top), bottom) for top, bottom in goal)
                for goal in labels.goals
            ],
        ),
    )


def test_they_are_numbered_by_what_is_done_with_them(entities: EntitySet) -> None:
    assert entities.cargo == 10
    assert entities.names[: entities.cargo] == (*ENTITIES[:5], *TINS)
    assert entities.places[entities.stick :] == ("stick", "shared")
    numbers = torch.arange(10 * 16 * 2 + 4 * 10 * 2 + 2 + 1)
    decisions = decision_of(numbers, 2, entities)
    assert number_of(decisions, 2, entities).tolist() == numbers.tolist()


def test_reachnet_learns_of_them(entities: EntitySet) -> None:
    model = tiny("reachnet", entities=entities.names)
    assert model.config.entities == entities.names
    batch = with_tins(drawn_batch(4), entities)
    total(model.loss(batch)).backward()
    found = gradients(model)
    assert all(grad is not None and grad.isfinite().all() for grad in found.values())
    assert set(model.score(batch)) >= {"plan", "near"}


def test_the_transformer_names_them(entities: EntitySet) -> None:
    model = EpisodicTransformer(
        EpisodicTransformerConfig(
            entities=entities.names, width=24, heads=2, channels=(8, 8, 8, 8), grid=2
        )
    )
    batch = with_tins(drawn_batch(3), entities)
    assert total(model.loss(batch)).isfinite()
    assert model.heads[3].out_features == len(entities) + 1


def test_they_change_colors(entities: EntitySet) -> None:
    batch = with_tins(drawn_batch(3), entities)
    order = torch.tensor([[1, 2, 3, 4, 0]]).expand(3, 5)
    changed = permute_colors(batch, order)
    for now, then in zip(
        labels_of(changed).decision[:2], labels_of(batch).decision[:2], strict=True
    ):
        name, before = entities.names[int(now[2])], entities.names[int(then[2])]
        assert name.endswith("_tin")
        colors = entities.colors
        place = colors.index(before.removesuffix("_tin"))
        assert name == f"{colors[(place + 1) % 5]}_tin"


def test_what_has_no_number_is_told(entities: EntitySet) -> None:
    with pytest.raises(InvalidConfigError, match="no number for 'red_tin'"):
        BENCHMARK.number("red_tin")
    objects = labels_of(with_tins(drawn_batch(2), entities)).objects.numpy()
    with pytest.raises(DatasetError, match="tin on tables"):
        poses_of(objects, entities.names, BENCHMARK)
