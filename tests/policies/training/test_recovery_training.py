"""Recovery states in training: as many as asked for, and never where they judge."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import tiny_model
import torch
from batches import drawn_batch, labels_of
from painted_keyframes import painted, painted_recovery  # noqa: F401 - fixtures
from tiny_model import NAME, Tiny, TinyConfig
from tiny_transformer import tiny

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.policies.batch import MAX_PAST, NOBODY, Batch
from lemma.policies.entities import BENCHMARK
from lemma.policies.frames import Frames
from lemma.policies.models.episodic_transformer import layout_of_batch
from lemma.policies.training.config import Augmentation, TrainingConfig
from lemma.policies.training.distributed import ProcessGroup
from lemma.policies.training.loader import BatchLoader, FrameSource, Sampler, joined
from lemma.policies.training.loop import train
from lemma.policies.training.run import read_frames, recovery_units, training_units

ALONE = ProcessGroup(0, 1, torch.device("cpu"))
GREEN_PAD = BENCHMARK.places.index("green_pad")

tiny_model.register()


@pytest.fixture
def config(data: Path, recovery: Path, tmp_path: Path) -> TrainingConfig:
    return TrainingConfig(
        model=NAME,
        data=data,
        out=tmp_path / "run",
        recovery=recovery,
        steps=12,
        batch_size=4,
        val_every=6,
        warmup_steps=4,
        augmentation=Augmentation.none(),
    )


def feed_of(config: TrainingConfig, rank: int = 0, processes: int = 1) -> BatchLoader:
    """Return a feed as training makes it."""
    config = config.resolved()
    data = read_frames(config, ALONE)
    model = Tiny(TinyConfig())
    units = training_units(model, data.train, config)
    order = Sampler(len(units), config.batch_size or 1, config.seed, rank, processes)
    source = None
    if data.recovery is not None:
        others = recovery_units(model, data.recovery, units, data.train)
        source = FrameSource(
            data.recovery,
            others,
            replace(order, units=len(others), name="recovery"),
            config.recovery_share or 0.0,
        )
    return BatchLoader(data.train, units, order, config, ALONE.device, source)


def mixed_in(feed: BatchLoader, step: int) -> list[bool]:
    found: list[bool] = labels_of(feed.make(step)).perturbed.tolist()
    return found


def test_history_is_what_was_executed_and_labels_are_the_experts(
    data: Path, recovery: Path
) -> None:
    exact, perturbed = Frames.load(data), Frames.load(recovery)
    frames = range(6)
    ours, theirs = exact.batch(frames), perturbed.batch(frames)
    # The same episodes were painted, so that only the history differs.
    assert torch.equal(labels_of(ours).decision, labels_of(theirs).decision)
    assert not labels_of(ours).perturbed.any()
    assert labels_of(theirs).perturbed.all()
    decision = labels_of(theirs).decision
    for row in (1, 2, 4, 5):
        first = row - row % 3
        for number in range(row - first):
            robot, primitive, pick, place = theirs.past[row, number].tolist()
            told = decision[first + number].tolist()
            assert robot == 1 - told[0]
            assert [primitive, pick] == told[1:3]
            assert place == GREEN_PAD
            assert ours.past[row, number].tolist() == told
    assert theirs.sub_instructions == ours.sub_instructions


def test_the_episodic_transformer_remembers_what_was_executed(recovery: Path) -> None:
    batch = Frames.load(recovery).batch(range(6))
    layout = layout_of_batch(batch)
    assert layout.episode.tolist() == [0, 0, 0, 1, 1, 1]
    done = layout.actions[:, :2]
    assert (done[..., 3] == GREEN_PAD).all()
    assert (layout.actions[:, 2:] == NOBODY).all()
    assert done.shape[1] < MAX_PAST
    # Its target is the expert's decision.
    assert not (labels_of(batch).decision[:2, 3] == GREEN_PAD).all()
    assert not layout.foreseeable.any()


def test_first_views_are_shown_throughout_only_where_nothing_went_wrong() -> None:
    model = tiny(first_view_only=1.0).train()
    batch = drawn_batch(4)
    layout = layout_of_batch(batch)
    cells = torch.randn(4, 3)
    assert torch.equal(model._first_views(cells, layout), cells[[0, 0, 0, 0]])
    labels = replace(labels_of(batch), perturbed=torch.ones(4, dtype=torch.bool))
    wrong = layout_of_batch(replace(batch, labels=labels))
    assert torch.equal(model._first_views(cells, wrong), cells)


@pytest.mark.parametrize("share", [0.25, 0.3, 0.1, 1.0])
def test_the_share_is_met(config: TrainingConfig, share: float) -> None:
    feed = feed_of(replace(config, recovery_share=share))
    counts = [sum(mixed_in(feed, step)) for step in range(10)]
    assert sum(counts) == round(10 * 4 * share)
    assert max(counts) - min(counts) <= 1
    assert all(len(mixed_in(feed, step)) == 4 for step in range(10))


def test_a_quarter_is_mixed_in_if_nothing_is_said(config: TrainingConfig) -> None:
    assert config.resolved().recovery_share == 0.25
    assert replace(config, recovery=None).resolved().recovery_share is None
    assert TrainingConfig.from_dict(config.resolved().to_dict()) == config.resolved()


def test_without_recovery_states_batches_are_what_they_were(
    config: TrainingConfig,
) -> None:
    feed = feed_of(replace(config, recovery=None))
    units = Sampler(30, 4, 0).step(2)
    expected = Frames.load(config.data).batch(units)
    assert torch.equal(feed.make(2).rgb, expected.rgb)


def test_every_recovery_state_is_drawn_once_in_each_pass(
    config: TrainingConfig,
) -> None:
    feed = feed_of(replace(config, recovery_share=0.5))
    frames = Frames.load(config.recovery or Path())
    drawn = []
    for step in range(9):
        labels = labels_of(feed.make(step))
        rows = torch.stack([labels.episode, labels.keyframe])[:, labels.perturbed]
        drawn += rows.t().tolist()
    assert len(frames) == 18
    assert sorted(drawn) == [[10 + i // 3, i % 3] for i in range(18)]


def test_processes_together_draw_what_one_does(config: TrainingConfig) -> None:
    config = replace(config, recovery_share=0.3)
    ranks = [feed_of(config, rank, 2) for rank in (0, 1)]
    alone = feed_of(replace(config, batch_size=8))
    both: list[tuple[int, ...]] = []
    one: list[tuple[int, ...]] = []
    for step in range(20):
        for feed, found in ((ranks[0], both), (ranks[1], both), (alone, one)):
            labels = labels_of(feed.make(step))
            rows = torch.stack([labels.episode, labels.keyframe]).t().tolist()
            found += map(tuple, rows)
        assert len({len(feed.make(step)) for feed in ranks}) == 1
    assert sorted(both) == sorted(one)


def test_recovery_states_are_never_validated_on(
    config: TrainingConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[bool] = []
    trained: list[bool] = []
    score, loss = Tiny.score, Tiny.loss

    def judge(model: Tiny, batch: Batch) -> dict[str, torch.Tensor]:
        judged.extend(labels_of(batch).perturbed.tolist())
        return score(model, batch)

    def learn(model: Tiny, batch: Batch) -> dict[str, torch.Tensor]:
        trained.extend(labels_of(batch).perturbed.tolist())
        return loss(model, batch)

    monkeypatch.setattr(Tiny, "score", judge)
    monkeypatch.setattr(Tiny, "loss", learn)
    report = train(config)
    # Two validations and one of each kind of instruction, of 12 frames.
    assert len(judged) == 4 * 12
    assert not any(judged)
    assert sum(trained) == len(trained) // 4 == 12
    assert report.passes == 1.2
    kept = {"benchmark", "digest", "of_any_renderer", "renderer", "recovery"}
    assert set(report.data) == kept


def test_whole_episodes_are_mixed_in_for_models_that_want_them(
    config: TrainingConfig,
) -> None:
    report = train(replace(config, model=f"{NAME}-episodes"))
    assert report.samples == 12 * 4 * 3


def test_instances_that_are_not_trained_on_stay_unknown(
    config: TrainingConfig,
) -> None:
    data = read_frames(config, ALONE)
    assert data.recovery is not None
    model = Tiny(TinyConfig())
    units = [tuple(range(3)), (12, 13, 14)]
    found = recovery_units(model, data.recovery, units, data.train)
    instances = {data.recovery.instances[unit[0]] for unit in found}
    assert instances == {data.train.instances[0], data.train.instances[12]}
    assert len(found) == 6
    with pytest.raises(DatasetError, match="No recovery state"):
        recovery_units(model, data.recovery, [(27, 28, 29)], data.train)


def test_only_the_split_that_is_trained_on_is_read(
    config: TrainingConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[object, str]] = []
    load = Frames.load

    def spy(folder: Path, split: str, *rest: Any, **how: Any) -> Frames:
        asked.append((folder, split))
        return load(folder, split, *rest, **how)

    monkeypatch.setattr(Frames, "load", spy)
    read_frames(config, ALONE)
    assert (config.recovery, "train") in asked
    assert (config.recovery, "val") not in asked


def test_the_two_kinds_of_data_are_not_mistaken_for_one_another(
    config: TrainingConfig,
) -> None:
    with pytest.raises(DatasetError, match="takes perturbed executions"):
        train(replace(config, recovery=config.data))
    assert config.recovery is not None
    with pytest.raises(DatasetError, match="mixed in with --recovery"):
        train(replace(config, data=config.recovery))


def test_another_mixture_is_another_run(config: TrainingConfig) -> None:
    train(config)
    for other in (
        replace(config, recovery=None),
        replace(config, recovery_share=0.5),
    ):
        with pytest.raises(DatasetError, match="another run"):
            train(other)


@pytest.mark.parametrize("share", [0.0, -0.5, 1.5])
def test_a_share_is_one(config: TrainingConfig, share: float) -> None:
    with pytest.raises(InvalidConfigError, match=r"recovery_share .*; expected"):
        replace(config, recovery_share=share)
    with pytest.raises(InvalidConfigError, match="--recovery DIR"):
        replace(config, recovery=None, recovery_share=0.5)


def test_joined_batches_keep_their_episodes_apart(data: Path, recovery: Path) -> None:
    one, other = Frames.load(data).batch([0, 4]), Frames.load(recovery).batch([1, 5])
    batch = joined(one, other, 10)
    labels = labels_of(batch)
    assert labels.episode.tolist() == [0, 1, 10, 11]
    assert labels.tasks == [*labels_of(one).tasks, *labels_of(other).tasks]
    assert len(batch) == len(batch.instructions) == len(batch.sub_instructions) == 4
    assert torch.equal(batch.joints[2:], other.joints)
