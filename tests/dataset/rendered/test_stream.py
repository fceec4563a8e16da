"""Frames for training, without a disk between."""

import pickle
from collections.abc import Iterator
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from rendered_sets import SPLIT, TASKS, recipe, recipe_folder

from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.core.workers.serial import Serial
from lemma.dataset.instructions import Language
from lemma.dataset.rendered import film as film_module
from lemma.dataset.rendered.film import Filming, film
from lemma.dataset.rendered.steps import iterate_steps
from lemma.dataset.rendered.stream import FrameStream, Sample
from lemma.scene.rendering.renderer import Renderer

HOW = Filming(hz=2, width=24, height=16, depth=True)
PARTS = {"rgb", "depth_m", "state", "action", "subtask", "index"}


def stream(**changes: Any) -> FrameStream:
    fields: dict[str, Any] = {
        "recipe": recipe_folder(),
        "split": SPLIT,
        "tasks": TASKS[:1],
        "how": HOW,
        "engine": Serial(),
    }
    return FrameStream(**{**fields, **changes})


def keys() -> list[str]:
    """Return those of the stream's episodes, in the recipe's order."""
    return [record.key for record in recipe().select(task=TASKS[0])]


@cache
def episodes() -> list[Sample]:
    return list(stream().episodes())


@pytest.mark.render
def test_frames_are_what_the_renderer_sees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film_module, "states_at_once", lambda *_: 3)
    record = recipe()[0]
    frames = list(film(record, HOW))
    alone = Renderer(HOW.width, HOW.height)
    steps = iterate_steps(record, HOW.hz)
    for frame, step in zip(frames, steps, strict=True):
        assert frame.step.index == step.index
        assert np.array_equal(frame.step.joints, step.joints)
        if step.index % 5:
            continue
        for number in range(2):
            model, data = step.scene.model, step.scene.data
            image = alone.rgbd(model, data, f"robot_{number}/camera")
            assert np.array_equal(frame.rgb[number], image.rgb)
            assert frame.depth_m is not None
            off_m = np.abs(frame.depth_m[number] - image.depth_m)
            assert off_m.max() < 0.00006


@pytest.mark.render
def test_episodes_are_those_of_the_recipe() -> None:
    assert sorted(one["key"] for one in episodes()) == sorted(keys())
    for one in episodes():
        record = next(record for record in recipe() if record.key == one["key"])
        length = len(one["index"])
        assert set(one) == PARTS | {"key", "task", "instruction"}
        assert one["rgb"].shape == (length, 2, 16, 24, 3)
        assert one["depth_m"].shape == (length, 2, 16, 24)
        assert one["state"].shape == one["action"].shape == (length, 14)
        assert one["index"].tolist() == list(range(length))
        assert one["subtask"][-1] == -1
        assert one["instruction"] == record.high_level


@pytest.mark.render
def test_every_frame_is_in_one_batch() -> None:
    batches = list(stream(how=Filming(hz=1, width=24, height=16)).batches(10, mix=2))
    assert [len(one["index"]) for one in batches[:-1]] == [10] * (len(batches) - 1)
    found = [
        (key, index)
        for one in batches
        for key, index in zip(one["key"], one["index"].tolist(), strict=True)
    ]
    assert len(found) == len(set(found))
    assert {key for key, _ in found} == set(keys())
    assert set(batches[0]["key"]) == set(keys())
    assert batches[0]["rgb"].shape == (10, 2, 16, 24, 3)
    assert "depth_m" not in batches[0]


class Late(Serial):
    """Sends jobs to itself, and ends the first one last, as workers may."""

    def run(self, function: Any, jobs: Any, *listener: Any) -> Iterator[Any]:
        for job in reversed(jobs):
            yield function(*pickle.loads(pickle.dumps(job)))


@pytest.mark.render
def test_order_does_not_depend_on_who_is_first() -> None:
    few = Filming(hz=1, width=4, height=4)
    late = stream(how=few, engine=Late()).episodes()
    assert [one["key"] for one in late] == [one["key"] for one in episodes()]


class Noting(Serial):
    """Does nothing but note which episodes were asked for."""

    def __init__(self) -> None:
        self.keys: list[str] = []

    def run(self, function: Any, jobs: Any, *listener: Any) -> Iterator[Any]:
        self.keys += [job[-1][0][0].key for job in jobs]
        return iter(())


def test_another_epoch_has_another_order() -> None:
    orders = set()
    for seed, epoch in product(range(3), range(3)):
        noting = Noting()
        assert list(stream(tasks=(), seed=seed, engine=noting).episodes([epoch])) == []
        assert sorted(noting.keys) == sorted(record.key for record in recipe())
        orders.add(tuple(noting.keys))
    assert len(orders) > 3


def test_epochs_follow_one_another() -> None:
    both, first, second = Noting(), Noting(), Noting()
    for noting, epochs in ((both, range(2)), (first, [0]), (second, [1])):
        list(stream(engine=noting).episodes(epochs))
    assert both.keys == first.keys + second.keys


@pytest.mark.render
def test_tasks_and_sentences_are_chosen() -> None:
    few = Filming(hz=1, width=4, height=4, cameras=("overview",))
    only = stream(how=few, tasks=TASKS[1:], language=Language(kind="human"))
    found = list(only.episodes())
    assert {one["task"] for one in found} == {TASKS[1]}
    humans = {record.human for record in recipe()}
    assert {one["instruction"] for one in found} <= humans
    assert found[0]["rgb"].shape[1:] == (1, 4, 4, 3)


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"split": "train"}, UnknownNameError, "val"),
        ({"tasks": ("juggle",)}, UnknownNameError, "pass"),
        ({"how": Filming(cameras=("drone",))}, UnknownNameError, "overview"),
        ({"how": Filming(renderer="vulkan")}, UnknownNameError, "opengl"),
    ],
)
def test_what_is_not_there_is_said(
    changes: dict[str, object], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        next(stream(**changes).episodes())


@pytest.mark.parametrize(
    "make",
    [
        lambda: Filming(hz=7),
        lambda: Filming(width=0),
        lambda: next(stream().batches(0)),
        lambda: next(stream().batches(8, mix=0)),
    ],
)
def test_impossible_numbers_are_refused(make: object) -> None:
    with pytest.raises(InvalidConfigError):
        make()  # type: ignore[operator]


def test_a_folder_without_a_recipe_is_refused(tmp_path: object) -> None:
    with pytest.raises(DatasetError):
        next(stream(recipe=tmp_path).episodes())
