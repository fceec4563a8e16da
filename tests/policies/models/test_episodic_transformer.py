import copy
import gc
from dataclasses import replace
from functools import partial

import batches
import pytest
import torch
from batches import drawn_batch, labels_of, part_of
from tiny_models import tiny as tiny_model

from lemma.policies.batch import MAX_PAST, NOBODY, STOP, Batch
from lemma.policies.compose import MultiStep
from lemma.policies.entities import BENCHMARK
from lemma.policies.interfaces import PastStep, PolicyInput
from lemma.policies.models.base import MODELS, subtask_of
from lemma.policies.models.episodic_transformer import (
    PARTS,
    SLOTS,
    EpisodicTransformer,
    EpisodicTransformerConfig,
    attention_mask,
    choose,
    layout_of_batch,
)
from lemma.policies.training.loader import joined
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.subtask import Primitive, SubTask

PLACES = BENCHMARK.places

tiny = partial(tiny_model, "episodic-transformer")


def episodes(*sizes: int) -> Batch:
    """Return several episodes one after the other."""
    batch, *others = (drawn_batch(size, seed) for seed, size in enumerate(sizes))
    for number, other in enumerate(others, 1):
        batch = joined(batch, other, number)
    return batch


def decided(batch: Batch) -> list[SubTask]:
    rows = labels_of(batch).decision.tolist()
    return [subtask_of(row, BENCHMARK) for row in rows]


def inputs_of(batch: Batch) -> list[PolicyInput]:
    """Return what a policy is given at each frame of one episode."""
    past: tuple[PastStep, ...] = ()
    found = []
    for given, subtask in zip(batches.inputs_of(batch), decided(batch), strict=True):
        found.append(given.with_past(past))
        past = (*past, PastStep(given.view, subtask))
    return found


def test_it_is_known_by_name_and_trains_on_episodes() -> None:
    assert MODELS["episodic-transformer"] == (
        EpisodicTransformer,
        EpisodicTransformerConfig,
    )
    assert EpisodicTransformer.unit == "episode"


def test_the_default_fits_the_weights_that_ship() -> None:
    model = EpisodicTransformer(EpisodicTransformerConfig())
    assert sum(weight.numel() for weight in model.parameters()) < 17.5e6


@pytest.mark.slow
def test_it_overfits_an_episode_and_then_acts_it_out() -> None:
    batch = drawn_batch(4)
    model = tiny()
    optimiser = torch.optim.Adam(model.parameters(), 3e-3)
    losses = []
    for _ in range(60):
        loss = torch.stack(list(model.loss(batch).values())).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.2 * losses[0]
    model.eval()
    assert model.score(batch)["plan"].tolist() == [1.0] * 4
    assert model.plan(inputs_of(batch)) == decided(batch)


def test_scores_and_losses_leave_out_what_stop_does_not_say() -> None:
    score = tiny().eval().score(drawn_batch(3))
    assert set(score) == {*PARTS, "plan"}
    assert torch.isnan(score["robot"]).tolist() == [False, False, True]
    assert torch.isnan(score["pick"]).tolist() == [False, False, True]
    assert not torch.isnan(score["plan"]).any()
    assert not torch.isnan(score["primitive"]).any()
    assert tiny().loss(drawn_batch(1))["robot"].item() == 0.0


@pytest.mark.parametrize("second_look", [False, True])
def test_episodes_in_a_batch_do_not_touch_each_other(second_look: bool) -> None:
    model = tiny(second_look=second_look).eval()
    batch = episodes(3, 4, 2)
    with torch.inference_mode():
        together = model(batch)
        alone = model(part_of(batch, [3, 4, 5, 6]))
    for whole, part in zip(together, alone, strict=True):
        assert torch.allclose(whole[3:7], part, atol=1e-4)


@pytest.mark.parametrize("second_look", [False, True])
def test_a_frame_does_not_see_what_comes_after_it(second_look: bool) -> None:
    model = tiny(second_look=second_look).eval()
    batch = drawn_batch(4)
    with torch.inference_mode():
        whole = model(batch)
        early = model(part_of(batch, [0, 1]))
        # Earlier views do matter.
        single = model(part_of(batch, [1]))
    for a, b, c in zip(whole, early, single, strict=True):
        assert torch.allclose(a[:2], b, atol=1e-4)
        assert not torch.allclose(a[1:2], c, atol=1e-4)


def test_a_second_look_counts_and_learns() -> None:
    model = tiny(second_look=True)
    torch.stack(list(model.loss(drawn_batch(3)).values())).sum().backward()
    look = model.look.multihead_attn.in_proj_weight
    for part in (model.cell_token.weight, model.cell_places, look):
        assert part.grad.abs().sum() > 0


def test_a_batch_splits_where_frames_do_not_follow() -> None:
    batch = part_of(episodes(3, 4), [0, 1, 2, 4, 5, 3, 6])
    layout = layout_of_batch(batch)
    assert layout.episode.tolist() == [0, 0, 0, 1, 1, 2, 3]
    assert layout.slot.tolist() == [0, 1, 2, 1, 2, 0, 3]
    assert (layout.actions[:, :, 1] != NOBODY).sum(1).tolist() == [2, 2, 0, 3]
    assert layout.present.sum(1).tolist() == [3, 2, 1, 1]


def test_long_histories_are_shortened() -> None:
    model = tiny()
    last = inputs_of(drawn_batch(3))[-1]
    given = last.with_past(last.past * 9)
    assert len(given.past) > MAX_PAST
    assert len(model.plan([given])) == 1
    batch = drawn_batch(16)
    layout = layout_of_batch(batch)
    assert int(layout.slot.max()) == SLOTS - 1
    assert all(torch.isfinite(term) for term in model.loss(batch).values())


def test_the_mask_lets_nobody_look_ahead() -> None:
    words, slots = 2, 3
    there = torch.ones(1, slots, dtype=torch.bool)
    mask = attention_mask(
        torch.tensor([[True, False]]), there, torch.tensor([[True, True]])
    )[0]
    assert mask[0].tolist() == [True, False, *[False] * 5]
    second = words + 1
    assert mask[second].tolist() == [True, False, True, True, False, True, False]
    first_decision = words + slots
    assert mask[first_decision].tolist() == (
        [True, False, True, False, False, True, False]
    )
    assert mask.diagonal().all()


def test_what_is_chosen_can_always_be_said() -> None:
    torch.manual_seed(0)
    scores = [torch.randn(500, n) for n in (2, 6, len(ENTITIES), len(PLACES))]
    given = inputs_of(drawn_batch(1))[0]
    kinds = set()
    for row in choose(scores).tolist():
        kinds.add(row[1])
        if row[1] == STOP:
            assert row == [NOBODY, STOP, NOBODY, NOBODY]
            continue
        subtask = SubTask(
            f"robot_{row[0]}",
            list(Primitive)[row[1]],
            ENTITIES[row[2]],
            PLACES[row[3]],
        )
        assert given.words_for(subtask)
        assert subtask.pick != subtask.place
    assert len(kinds) == 6


def test_a_lone_robot_is_never_told_to_be_the_second() -> None:
    model = tiny().eval()
    given = inputs_of(drawn_batch(1))[0]
    with torch.no_grad():
        model.get_parameter("heads.0.bias").copy_(torch.tensor([-50.0, 50.0]))
        model.get_parameter("heads.1.bias")[0] = 50.0
    assert model.plan([given])[0].robot == "robot_1"
    assert model.plan([replace(given, robots=("red robot",))])[0].robot == "robot_0"


def test_views_are_looked_at_once_and_forgotten_with_their_holder() -> None:
    model = tiny().eval()
    seen = []
    model.frames.register_forward_hook(lambda _, given, __: seen.append(len(given[0])))
    given = inputs_of(drawn_batch(3))
    model.plan([given[2]])
    model.plan([given[1], given[2]])
    MultiStep(model).plan([given[2]])
    assert seen == [3]
    assert len(copy.deepcopy(model)._seen) == 0
    del given
    gc.collect()
    assert len(model._seen) == 0


@pytest.mark.parametrize("change", ["step", "load"])
def test_features_are_forgotten_when_weights_change(change: str) -> None:
    model = tiny().eval()
    given = inputs_of(drawn_batch(2))
    model.plan(given)
    before = model._cells_of([given[0].view])
    other = tiny()
    with torch.no_grad():
        other.frames.stem.weight.mul_(2.0)
        if change == "step":
            model.frames.stem.weight.mul_(2.0)
        else:
            model.load_state_dict(other.state_dict())
    model.plan(given)
    after = model._cells_of([given[0].view])
    assert not torch.allclose(before, after)


def test_multi_step_planning_sees_the_first_view_only() -> None:
    model = tiny().eval()
    given = inputs_of(drawn_batch(3))[2]
    past = tuple(replace(step, view=given.past[0].view) for step in given.past)
    frozen = replace(given, view=given.past[0].view, past=past)
    assert MultiStep(model).plan([given]) == model.plan([frozen])


def test_training_can_show_the_first_view_throughout() -> None:
    batch = drawn_batch(3)
    first = replace(
        batch,
        rgb=batch.rgb[:1].expand_as(batch.rgb),
        height_m=batch.height_m[:1].expand_as(batch.height_m),
    )
    model = tiny(first_view_only=1.0).train()
    with torch.no_grad():
        for part in model.text.modules():
            part.eval()
        for a, b in zip(model(batch), model(first), strict=True):
            assert torch.allclose(a, b, atol=1e-4)
