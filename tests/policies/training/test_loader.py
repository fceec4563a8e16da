"""The feed of batches: the same for every device, in whatever order it is made."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import pytest
import torch
from operations import Operations
from painted_keyframes import painted, painted_recovery  # noqa: F401 - fixtures
from tiny_model import Tiny, TinyConfig, config
from torch.utils._pytree import tree_leaves

from lemma.policies.batch import Batch, moved
from lemma.policies.frames import Frames
from lemma.policies.models.reachnet.model import ReachNet
from lemma.policies.training.config import Augmentation
from lemma.policies.training.distributed import ProcessGroup
from lemma.policies.training.loader import AHEAD, PROCESSES, BatchLoader, Sampler
from lemma.policies.training.run import training_units

ALONE = ProcessGroup(0, 1, torch.device("cpu"))


class OnCpu(torch.Generator):
    """A generator of random numbers on the CPU for any device."""

    def __new__(cls, device: torch.device) -> "OnCpu":
        return super().__new__(cls)


class OneDevice(Operations):
    """Fails where an operation has tensors of two devices, which a GPU waits for."""

    def look(self, name: str, args: tuple[Any, ...]) -> None:
        tensors = (one for one in tree_leaves(args) if isinstance(one, torch.Tensor))
        devices = {one.device.type for one in tensors if one.ndim}
        assert len(devices) <= 1 or name in ("_to_copy", "copy_"), name


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> torch.device:
    """A stand-in for a GPU, from which nothing can be read back."""
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda tensor: tensor)
    monkeypatch.setattr(torch, "Generator", OnCpu)
    return torch.device("meta")


@pytest.mark.parametrize("recolored", [True, False])
def test_the_feed_reads_nothing_back_from_the_gpu_and_sends_it_everything(
    data: Path, tmp_path: Path, gpu: torch.device, recolored: bool
) -> None:
    frames, options = Frames.load(data), config(data, tmp_path).resolved()
    augmentation = Augmentation(palette=recolored, rotate_deg=20.0)
    options = replace(options, augmentation=augmentation)
    units = training_units(Tiny(TinyConfig()), frames, options)
    order = Sampler(len(units), 4, 0)
    with OneDevice():
        here, there = (
            BatchLoader(frames, units, order, options, device).make(3)
            for device in (ALONE.device, gpu)
        )
    assert_same_but_for_the_device(here, there)


def test_frames_on_a_gpu_are_drawn_there(data: Path, gpu: torch.device) -> None:
    frames, there = Frames.load(data), Frames.load(data, device=gpu)
    assert there.rgb.device == gpu
    assert there.batch([0]).rgb.device == gpu
    assert_same_but_for_the_device(
        frames.batch([2, 0]), moved(there.batch([2, 0]), gpu)
    )


def test_a_batch_is_wholly_on_the_device_that_it_is_moved_to(
    data: Path, gpu: torch.device
) -> None:
    frames = Frames.load(data)
    assert_same_but_for_the_device(
        frames.batch([0, 2]), moved(frames.batch([0, 2], gpu), gpu)
    )


def assert_same_but_for_the_device(here: Batch, there: Batch) -> None:
    assert here.labels is not None
    assert there.labels is not None
    seen = 0
    for one, other in ((here, there), (here.labels, there.labels)):
        for name, value in vars(one).items():
            if isinstance(value, torch.Tensor):
                sent = getattr(other, name)
                assert (value.device.type, sent.device.type) == ("cpu", "meta")
                assert (value.shape, value.dtype) == (sent.shape, sent.dtype)
                seen += 1
            elif name != "labels":
                assert value == getattr(other, name)
    assert seen > 10


def test_batches_are_the_same_ahead_and_at_once(
    data: Path, tmp_path: Path, switches_at_once: None
) -> None:
    frames, options = Frames.load(data), config(data, tmp_path).resolved()
    units = training_units(Tiny(TinyConfig()), frames, options)
    order, reader = Sampler(len(units), 4, 0), ReachNet()
    feed = BatchLoader(frames, units, order, options, ALONE.device, model=reader)
    with feed.ahead(5, 17) as batches:
        ahead = list(batches)
    assert len(ahead) == 12 > AHEAD
    for step, batch in zip(range(5, 17), ahead, strict=True):
        again = feed.make(step)
        assert len(batch.text_tensors["goal"]) == 4 + 2 + 8
        assert torch.equal(batch.rgb, again.rgb)
        assert batch.instructions == again.instructions
        for name, tensor in again.text_tensors.items():
            assert torch.equal(batch.text_tensors[name], tensor)


@pytest.fixture
def switches_at_once() -> Iterator[None]:
    """Let threads take turns as often as possible, which shows what they share."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def test_other_processes_draw_lessons_for_a_gpu_and_end_with_the_feed(
    data: Path, tmp_path: Path, gpu: torch.device
) -> None:
    frames, options = Frames.load(data), config(data, tmp_path).resolved()
    units = training_units(Tiny(TinyConfig()), frames, options)
    order, reader = Sampler(len(units), 4, 0), ReachNet()
    here, there = (
        BatchLoader(frames, units, order, options, device, model=reader)
        for device in (ALONE.device, gpu)
    )
    before = set(active_children())
    with there.ahead(0, 100) as batches:
        batch = next(batches)
        assert len(set(active_children()) - before) == PROCESSES
    assert set(active_children()) == before
    usual = here.make(0).text_tensors
    assert all(torch.equal(usual[n], t) for n, t in batch.text_tensors.items())
