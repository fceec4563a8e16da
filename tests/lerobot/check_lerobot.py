"""The real lerobot package reads what we write: `make test-lerobot`.

Run in an environment with lerobot and without this package; make_export.py has written
a data set and what must be found in it.
"""

import json
import math
import os
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from old_environment import allow_new_syntax, allow_torchvision_without_operators

os.environ["HF_HUB_OFFLINE"] = "1"
allow_new_syntax()
allow_torchvision_without_operators()

FOLDER = Path(os.environ["LEROBOT_EXPORT"])
VERSION = tuple(int(part) for part in version("lerobot").split(".")[:2])
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
EPISODES: list[dict[str, Any]] = EXPECTED["episodes"]
FPS: int = EXPECTED["fps"]
ROBOTS = ("robot_0", "robot_1")
KINDS = ("high_level", "human", "unseen")
READS_DEPTH = VERSION >= (0, 6)
READS_SUBTASKS = VERSION < (0, 6)


def lerobot_dataset(**options: Any) -> Any:
    module = import_module("lerobot.datasets.lerobot_dataset")
    return module.LeRobotDataset(
        "lemma/test", root=FOLDER / "dataset", video_backend="pyav", **options
    )


@cache
def dataset() -> Any:
    return lerobot_dataset()


def seen(episode: int) -> dict[str, np.ndarray]:
    told = EPISODES[episode]
    return dict(np.load(FOLDER / f"{told['split']}-{told['task']}.npz"))


def starts() -> list[int]:
    return [sum(e["length"] for e in EPISODES[:n]) for n in range(len(EPISODES))]


def psnr_db(ours: np.ndarray, theirs: np.ndarray) -> float:
    return -10 * math.log10(float(np.mean((ours - theirs) ** 2)))


def test_everything_is_there() -> None:
    meta = dataset().meta
    assert meta.total_episodes == dataset().num_episodes == len(EPISODES) == 4
    assert meta.total_frames == len(dataset()) == sum(e["length"] for e in EPISODES)
    assert meta.fps == FPS
    assert [row["lemma/key"] for row in meta.episodes] == [e["key"] for e in EPISODES]
    assert [row["dataset_from_index"] for row in meta.episodes] == starts()
    assert len(meta.tasks) == meta.total_tasks
    names = meta.features["action"]["names"]
    assert names[:1] + names[6:8] + names[13:] == [
        "robot_0.shoulder_pan",
        "robot_0.gripper",
        "robot_1.shoulder_pan",
        "robot_1.gripper",
    ]


def test_the_episodes_are_spread_over_several_files() -> None:
    rows = dataset().meta.episodes
    assert {row["data/file_index"] for row in rows} == set(
        range(EXPECTED["data_files"])
    )
    assert EXPECTED["data_files"] > 1
    key = "videos/observation.images.robot_0"
    assert len({row[f"{key}/file_index"] for row in rows}) > 1
    assert any(row[f"{key}/from_timestamp"] > 0 for row in rows)


@pytest.mark.parametrize("episode", range(4))
def test_states_actions_and_sentences(episode: int) -> None:
    told, arrays = EPISODES[episode], seen(episode)
    rows = dataset().hf_dataset.select(
        range(starts()[episode], starts()[episode] + told["length"])
    )
    tasks = dataset().meta.tasks.index
    for number, row in enumerate(rows):
        assert np.array_equal(
            row["observation.state"].numpy(), arrays["state"][number].astype(np.float32)
        )
        assert np.array_equal(
            row["action"].numpy(), arrays["action"][number].astype(np.float32)
        )
        assert row["frame_index"] == number
        assert row["episode_index"] == episode
        assert row["timestamp"].item() == pytest.approx(number / FPS, abs=1e-5)
        is_last = number == told["length"] - 1
        assert row["next.done"].item() is is_last
        assert row["next.success"].item() is (is_last and told["success"])
        assert row["next.reward"].item() == float(is_last and told["success"])
        for kind in KINDS:
            index = row[f"annotation.instruction.{kind}"].item()
            assert tasks[index] == told[kind]


@pytest.mark.parametrize("episode", range(4))
def test_items_are_what_was_rendered(episode: int) -> None:
    told, arrays = EPISODES[episode], seen(episode)
    for place, number in enumerate(arrays["at"]):
        item = dataset()[starts()[episode] + int(number)]
        assert item["task"] == told["high_level"]
        if READS_SUBTASKS:
            # At the end no sub-task is left: number -1, and words of their own.
            assert item["subtask"] == told["subtasks"][arrays["subtask"][number]]
        for camera, robot in enumerate(ROBOTS):
            theirs = item[f"observation.images.{robot}"].numpy().transpose(1, 2, 0)
            ours = arrays["rgb"][place, camera] / 255.0
            assert psnr_db(ours, theirs) > 33
            if READS_DEPTH:
                depth_mm = item[f"observation.images.{robot}_depth"].numpy()
                assert depth_mm.shape == (1, *ours.shape[:2])
                off = np.abs(depth_mm[0] / 1000 - arrays["depth"][place, camera])
                assert off.max() < 0.00051


def test_pictures_are_not_those_of_the_frame_before() -> None:
    """Judge the test above: its bound tells frames apart."""
    arrays = seen(0)
    item = dataset()[starts()[0] + int(arrays["at"][1])]
    theirs = item["observation.images.robot_0"].numpy().transpose(1, 2, 0)
    assert psnr_db(arrays["rgb"][-2, 0] / 255.0, theirs) < 33


@pytest.mark.parametrize("workers", [0, 2])
def test_a_data_loader_iterates_over_everything(workers: int) -> None:
    torch = import_module("torch")
    loader = torch.utils.data.DataLoader(
        dataset() if workers == 0 else lerobot_dataset(),
        batch_size=16,
        shuffle=True,
        num_workers=workers,
        generator=torch.Generator().manual_seed(0),
        # What lets old environments import lerobot is inherited, not imported.
        multiprocessing_context="fork" if workers else None,
    )
    found = []
    for batch in loader:
        count = len(batch["index"])
        assert batch["observation.images.robot_0"].shape == (count, 3, 240, 320)
        assert batch["observation.state"].shape == (count, 14)
        assert len(batch["task"]) == count
        found += batch["index"].tolist()
        if workers and len(found) > 100:
            return
    assert sorted(found) == list(range(len(dataset())))


def test_windows_of_frames_stay_within_their_episode() -> None:
    times = [-1 / FPS, 0.0, 1 / FPS]
    windows = lerobot_dataset(
        delta_timestamps={"observation.images.robot_1": times, "action": times}
    )
    first = windows[starts()[1]]
    assert first["action"].shape == (3, 14)
    assert first["observation.images.robot_1"].shape == (3, 3, 240, 320)
    assert first["action_is_pad"].tolist() == [True, False, False]
    expected = seen(1)["action"][[0, 0, 1]].astype(np.float32)
    assert np.array_equal(first["action"].numpy(), expected)


def test_episodes_can_be_chosen() -> None:
    chosen = lerobot_dataset(episodes=[2])
    assert len(chosen) == EPISODES[2]["length"]
    item = chosen[int(seen(2)["at"][1])]
    ours = seen(2)["rgb"][1, 0] / 255.0
    theirs = item["observation.images.robot_0"].numpy().transpose(1, 2, 0)
    assert psnr_db(ours, theirs) > 33


def test_statistics_are_those_that_lerobot_computes() -> None:
    compute = import_module("lerobot.datasets.compute_stats")
    stats = dataset().meta.stats
    assert stats["observation.images.robot_0"]["mean"].shape == (3, 1, 1)
    table = dataset().hf_dataset.with_format("numpy")
    for key in ("observation.state", "action"):
        values = np.stack([np.asarray(row) for row in table[key]])
        theirs = compute.get_feature_stats(values, axis=0, keepdims=False)
        for figure in ("min", "max", "mean", "std"):
            assert stats[key][figure] == pytest.approx(theirs[figure], abs=1e-4)
        assert set(stats[key]) == set(theirs)
    listed = [dict(stats), dict(stats)]
    if READS_DEPTH:
        # Its own check of shapes, which earlier versions have for color alone.
        assert compute.aggregate_stats(listed)["action"]["count"] == 2 * len(dataset())
