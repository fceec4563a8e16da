"""Rendered keyframes as a training loop sees them."""

import gc
import os
import pickle
import shutil
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from shutil import copytree
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from rendered_sets import (
    SPLIT,
    TASKS,
    keyframes_folder,
    recipe,
    recipe_folder,
)

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.core.files import read_json, write_json
from lemma.dataset.files import MANIFEST
from lemma.dataset.instructions import Language
from lemma.dataset.rendered import dataset as keyframe_dataset
from lemma.dataset.rendered.dataset import (
    CAMERA_COLUMNS,
    MAP_COLUMNS,
    POLICY_COLUMNS,
    SHARED,
    KeyframeDataset,
    MapsInMemory,
    Sample,
)

pytestmark = pytest.mark.render

RESAMPLED = Language(instructions="resampled", seed=4)
DESCRIPTORS = Path("/proc/self/fd")


def dataset(**options: Any) -> KeyframeDataset:
    return KeyframeDataset(keyframes_folder(), SPLIT, **options)


def same(one: Sample, other: Sample) -> bool:
    return set(one) == set(other) and all(
        np.array_equal(value, other[name], equal_nan=True)
        if isinstance(value, np.ndarray)
        else value == other[name]
        for name, value in one.items()
    )


def test_length_and_order() -> None:
    keyframes = [record.keyframes for record in recipe()]
    found = dataset(columns=("key", "keyframe"))
    assert len(found) == sum(keyframes)
    assert [len(frames) for frames in found.episodes()] == keyframes
    for record, frames in zip(recipe(), found.episodes(), strict=True):
        assert [found[i]["key"] for i in frames] == [record.key] * record.keyframes
        assert [found[i]["keyframe"] for i in frames] == list(range(record.keyframes))


def test_indices_wrap_and_end() -> None:
    found = dataset()
    assert same(found[-1], found[len(found) - 1])
    for index in (len(found), -len(found) - 1):
        with pytest.raises(IndexError):
            found[index]


def test_samples_hold_what_was_asked_for() -> None:
    found = dataset(columns=("map_height", "pick"))[0]
    assert set(found) == {"map_height", "map_coverage", "pick", "instruction"}
    assert set(dataset(columns=CAMERA_COLUMNS)[0]) == {*CAMERA_COLUMNS, "instruction"}
    assert set(dataset()[0]) == {
        *(*MAP_COLUMNS, "map_coverage", *POLICY_COLUMNS, "instruction")
    }
    with pytest.raises(UnknownNameError, match="Did you mean 'joints'"):
        dataset(columns=("joint",))


def test_images_of_a_sample() -> None:
    sample = dataset()[0]
    height, seen = sample["map_height"], sample["map_coverage"]
    assert (sample["map_rgb"].dtype, height.dtype) == (np.uint8, np.uint16)
    assert (seen.dtype, seen.shape) == (np.bool_, (416, 416))
    assert np.array_equal(seen, height > 0)
    assert 0.3 < seen.mean() < 0.99
    assert not sample["map_rgb"][~seen].any()


def test_tasks_and_splits() -> None:
    whole = dataset(columns=("task",))
    one = dataset(tasks=(TASKS[1],), columns=("task",))
    assert {one[i]["task"] for i in range(len(one))} == {TASKS[1]}
    assert len(one) + len(dataset(tasks=(TASKS[0],))) == len(whole)
    with pytest.raises(UnknownNameError, match="Did you mean 'stack'"):
        dataset(tasks=("stak",))
    with pytest.raises(UnknownNameError, match="split in this data set 'train'"):
        KeyframeDataset(keyframes_folder(), "train")


def test_recorded_sentences() -> None:
    for kind in ("high_level", "human", "unseen"):
        found = dataset(columns=("key",), language=Language(kind=kind))
        for record, frames in zip(recipe(), found.episodes(), strict=True):
            expected = getattr(record, kind)
            assert {found[i]["instruction"] for i in frames} == {expected}
    with pytest.raises(UnknownNameError, match="kind of instruction"):
        dataset(language=Language(kind="poem"))


def test_a_recipe_and_its_keyframes_give_the_same_sentences() -> None:
    for language in (RESAMPLED, Language(kind="human")):
        found = dataset(columns=("key",), language=language)
        found.set_epoch(2)
        for record, frames in zip(recipe(), found.episodes(), strict=True):
            assert language.choose(record, 2) == found[frames[0]]["instruction"]
    training = replace(recipe()[0], split="train")
    with pytest.raises(DatasetError, match="held out"):
        Language(kind="unseen").choose(training)


def test_the_unseen_sentences_are_not_for_training(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="held out"):
        KeyframeDataset(tmp_path, "train", language=Language(kind="unseen"))


def test_drawn_sentences_depend_on_seed_and_epoch_alone() -> None:
    def sentences(seed: int, epoch: int, start: int) -> list[str]:
        found = dataset(
            columns=("key",), language=Language(instructions="resampled", seed=seed)
        )
        found.set_epoch(epoch)
        order = np.roll(np.arange(len(found)), start)
        said = {int(i): found[int(i)]["instruction"] for i in order}
        return [said[i] for i in range(len(found))]

    assert sentences(1, 2, 0) == sentences(1, 2, 5)
    assert sentences(1, 2, 0) != sentences(1, 3, 0)
    assert sentences(1, 2, 0) != sentences(2, 2, 0)
    with pytest.raises(UnknownNameError, match="source of instructions"):
        Language(instructions="drawn")


def read(found: KeyframeDataset, index: int) -> Sample:
    return found[index]


@pytest.mark.slow
def test_workers_read_the_same() -> None:
    found = dataset(language=RESAMPLED)
    found.set_epoch(3)
    here = found[5]
    assert len(pickle.dumps(found)) < 20_000
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert same(pool.submit(read, found, 5).result(), here)


def test_a_batch_is_its_samples() -> None:
    found = dataset(columns=(*MAP_COLUMNS, "pick_pose", "pick", "keyframe"))
    indices = [3, 0, 3, 7]
    batch = found.batch(indices)
    for row, index in enumerate(indices):
        sample = found[index]
        assert same(sample, {name: values[row] for name, values in batch.items()})
    assert batch["map_rgb"].dtype == np.uint8
    again = found.batch(np.array([1, 2, 4, 5]), batch)
    assert again["map_rgb"] is batch["map_rgb"]
    assert np.array_equal(again["map_rgb"][2], found[4]["map_rgb"])
    assert found[[2, 1]]["pick"] == [found[2]["pick"], found[1]["pick"]]


def test_everything_in_memory() -> None:
    found = dataset(language=RESAMPLED)
    memory = MapsInMemory.load(keyframes_folder(), SPLIT, language=RESAMPLED)
    assert len(memory) == len(found)
    assert memory.nbytes == len(found) * 416 * 416 * 5
    assert memory.rgb.flags.c_contiguous
    for index in range(len(found)):
        row = {name: values[index] for name, values in memory.columns.items()}
        row |= {"map_rgb": memory.rgb[index], "map_height": memory.height[index]}
        row["map_coverage"] = memory.coverage[index]
        assert same(row, found[index])
    assert memory.raster == found.raster


def test_processes_share_maps_in_a_file(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    shutil.copytree(keyframes_folder(), folder)
    alone = MapsInMemory.load(folder, SPLIT)
    first, second = (MapsInMemory.load(folder, SPLIT, shared=True) for _ in range(2))
    assert sum(path.suffix == ".npy" for path in (folder / SHARED).iterdir()) == 2
    for found in (first, second):
        assert np.array_equal(found.rgb, alone.rgb)
        assert np.array_equal(found.height, alone.height)
        assert isinstance(found.rgb, np.memmap)
        assert found.columns.keys() == alone.columns.keys()
        for name, values in alone.columns.items():
            assert repr(values.tolist()) == repr(found.columns[name].tolist())
    # Others do not see what one of them writes.
    second.rgb[0] = 0
    assert np.array_equal(MapsInMemory.load(folder, SPLIT, shared=True).rgb, alone.rgb)


def test_shared_maps_are_those_of_the_files_that_are_there_now(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    shutil.copytree(keyframes_folder(), folder)
    pictures = MapsInMemory.load(folder, SPLIT, shared=True)
    # Other pictures of as many keyframes, where nobody has deleted the maps.
    manifest = read_json(folder / MANIFEST)
    for entry in manifest["files"].values():
        entry["sha256"] = "0" * 64
    write_json(folder / MANIFEST, manifest)
    for path in (folder / SHARED).glob("*.npy"):
        np.save(path, np.zeros_like(np.load(path)))
    again = MapsInMemory.load(folder, SPLIT, shared=True)
    assert np.array_equal(again.rgb, MapsInMemory.load(folder, SPLIT).rgb)
    assert sum(path.suffix == ".npy" for path in (folder / SHARED).iterdir()) == 2
    assert len(pictures) == len(again)
    shutil.rmtree(folder / SHARED)
    (folder / SHARED).write_text("in the way")
    with pytest.raises(DatasetError, match="Leave out --shared-images"):
        MapsInMemory.load(folder, SPLIT, shared=True)


def open_files(folder: Path) -> int:
    """Return how many descriptors of this process lead into a folder."""
    # Collected files are closed.
    gc.collect()
    inside = f"{folder.resolve()}{os.sep}"
    found = [os.path.realpath(link) for link in DESCRIPTORS.iterdir()]
    return sum(path.startswith(inside) for path in found)


@pytest.mark.skipif(not DESCRIPTORS.is_dir(), reason="/proc says which files are open")
def test_threads_share_descriptors(tmp_path: Path) -> None:
    # A system allows a process about a thousand. In a folder of its own no other test
    # opens or closes any.
    folder = copytree(keyframes_folder(), tmp_path / "set")
    columns = (*MAP_COLUMNS, *POLICY_COLUMNS, *CAMERA_COLUMNS)
    found = KeyframeDataset(folder, SPLIT, columns=columns)
    start = Barrier(4)

    def read_first(_: int) -> Sample:
        start.wait()
        return found[0]

    assert open_files(folder) == 0
    with ThreadPoolExecutor(4) as pool:
        again = list(pool.map(read_first, range(4)))
        assert open_files(folder) == 2
    assert all(same(found[0], one) for one in again)


def test_files_are_opened_again_where_too_many_are_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = [dataset()[index] for index in range(len(dataset()))]
    monkeypatch.setattr(keyframe_dataset, "_OPEN_FILES", 1)
    folder = copytree(keyframes_folder(), tmp_path / "set")
    found = KeyframeDataset(folder, SPLIT)
    for _ in range(2):
        for index, sample in enumerate(expected):
            assert same(found[index], sample)
    if DESCRIPTORS.is_dir():
        assert open_files(folder) == 1


def test_a_folder_without_keyframes_is_explained(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no manifest.json.*'lemma render"):
        KeyframeDataset(tmp_path, SPLIT)
    with pytest.raises(DatasetError, match="has 'recipe'"):
        KeyframeDataset(recipe_folder(), SPLIT)
