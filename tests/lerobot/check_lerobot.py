"""The real lerobot package writes an export and reads it: `make test-lerobot`."""

import json
import math
import os
from dataclasses import replace
from functools import cache
from importlib import import_module
from itertools import product
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from small_recipe import SPLITS, TASKS, recipe

import lemma
from lemma.cli.main import main
from lemma.core.workers.pool import Serial
from lemma.dataset.lerobot.export import LeRobotConfig, write_dataset, write_shard
from lemma.dataset.lerobot.frames import Style
from lemma.dataset.lerobot.statistics import SMALLEST_STD
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.capture import label
from lemma.dataset.rendered.render import RenderConfig
from lemma.dataset.rendered.steps import iterate_steps
from lemma.dataset.teleoperation import (
    Executed,
    Teleoperation,
    joints_sha256,
    perform,
    read_record,
)
from lemma.env.episode import Episode
from lemma.scene.rendering.renderer import Renderer
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import Primitive, SubTask

os.environ["HF_HUB_OFFLINE"] = "1"

FPS = 10
STYLE = Style(fps=FPS, width_px=320, height_px=240, cameras=("robot_0", "robot_1"))
EVERY = 17
"""Frames from one picture that is compared to the next."""
ROBOTS = ("robot_0", "robot_1")
EPISODES = tuple((task, split) for split in SPLITS for task in TASKS)


@cache
def export() -> Path:
    out = Path(mkdtemp(prefix="lemma-lerobot-")) / "dataset"
    source = RenderConfig(recipe=recipe(), out=out)
    write_dataset(LeRobotConfig(source=source, style=STYLE), Serial())
    return out


def lerobot_dataset(**options: Any) -> Any:
    module = import_module("lerobot.datasets.lerobot_dataset")
    return module.LeRobotDataset(
        "lemma/test", root=export(), video_backend="pyav", **options
    )


@cache
def dataset() -> Any:
    return lerobot_dataset()


@cache
def record(episode: int) -> EpisodeRecord:
    task, split = EPISODES[episode]
    return lemma.load(recipe()).find(task, split, 0)


@cache
def seen(episode: int) -> dict[str, NDArray[Any]]:
    """Return what an episode looks like, by other means than the export's."""
    renderer = Renderer(STYLE.width_px, STYLE.height_px)
    found: dict[str, list[Any]] = {
        name: [] for name in ("state", "action", "subtask", "rgb", "depth", "at")
    }
    for step in iterate_steps(record(episode), FPS):
        state = np.concatenate([step.joints, step.opening_m[:, None]], axis=1)
        found["state"].append(state.ravel())
        found["action"].append(step.action.ravel())
        found["subtask"].append(step.subtask)
        if step.index % EVERY == 0 or step.is_done:
            model, data = step.scene.model, step.scene.data
            images = [renderer.rgbd(model, data, f"{robot}/camera") for robot in ROBOTS]
            found["at"].append(step.index)
            found["rgb"].append([image.rgb for image in images])
            found["depth"].append([image.depth_m for image in images])
    return {name: np.array(values) for name, values in found.items()}


def lengths() -> list[int]:
    return [len(seen(n)["state"]) for n in range(len(EPISODES))]


def starts() -> list[int]:
    return [sum(lengths()[:n]) for n in range(len(EPISODES))]


def psnr_db(ours: NDArray[Any], theirs: NDArray[Any]) -> float:
    return -10 * math.log10(float(np.mean((ours - theirs) ** 2)))


def test_everything_is_there() -> None:
    meta = dataset().meta
    assert meta.total_episodes == dataset().num_episodes == len(EPISODES)
    assert meta.total_frames == len(dataset()) == sum(lengths())
    assert meta.fps == FPS
    assert [row["dataset_from_index"] for row in meta.episodes] == starts()
    assert json.loads((export() / "meta/info.json").read_text())["splits"] == {
        "train": "0:2",
        "val": "2:4",
    }
    names = meta.features["action"]["names"]
    assert names[:1] + names[6:8] + names[13:] == [
        "robot_0.shoulder_pan",
        "robot_0.gripper",
        "robot_1.shoulder_pan",
        "robot_1.gripper",
    ]


def test_what_the_format_has_no_place_for_lies_beside_it() -> None:
    told = json.loads((export() / "extras/episodes.json").read_text())["episodes"]
    assert [one["key"] for one in told] == [record(n).key for n in range(4)]
    assert [one["length"] for one in told] == lengths()
    camera = told[0]["cameras"]["robot_1"]
    assert np.array(camera["world_from_camera"]).shape == (4, 4)
    assert camera["intrinsics_px"][2:] == [159.5, 119.5]
    assert len(lemma.load(export() / "extras")) == 4
    assert "license: apache-2.0" in (export() / "README.md").read_text()


@pytest.mark.parametrize("episode", range(4))
def test_states_actions_and_sentences(episode: int) -> None:
    told, arrays = record(episode), seen(episode)
    length = lengths()[episode]
    start = starts()[episode]
    for number, row in enumerate(
        dataset().hf_dataset.select(range(start, start + length))
    ):
        for name in ("state", "action"):
            key = "observation.state" if name == "state" else name
            assert np.array_equal(
                row[key].numpy(), arrays[name][number].astype(np.float32)
            )
        for part, robot in product(("state", "action"), range(2)):
            theirs = arrays[part][number].reshape(2, 7)[robot].astype(np.float32)
            assert np.array_equal(row[f"robot_{robot}.{part}"].numpy(), theirs)
        assert row["frame_index"] == number
        assert row["episode_index"] == episode
        assert row["timestamp"].item() == pytest.approx(number / FPS, abs=1e-5)
        is_last = number == length - 1
        assert row["next.done"].item() is is_last
        assert row["next.success"].item() is (is_last and told.success)
        assert row["next.reward"].item() == float(is_last and told.success)
        for kind in ("high_level", "human", "unseen"):
            assert row[f"annotation.instruction.{kind}"] == getattr(told, kind)
        number = arrays["subtask"][number]
        number = len(told.subtasks) if number < 0 else number
        assert row["subtask"] == label(told, number)["sub_instruction"]


@pytest.mark.parametrize("episode", range(4))
def test_items_are_what_was_rendered(episode: int) -> None:
    arrays = seen(episode)
    for place, number in enumerate(arrays["at"]):
        item = dataset()[starts()[episode] + int(number)]
        assert item["task"] == record(episode).high_level
        for camera, robot in enumerate(ROBOTS):
            theirs = item[f"observation.images.{robot}"].numpy().transpose(1, 2, 0)
            ours = arrays["rgb"][place, camera] / 255.0
            assert psnr_db(ours, theirs) > 33
            depth_mm = item[f"observation.images.{robot}_depth"].numpy()
            assert depth_mm.shape == (1, *ours.shape[:2])
            # Half a level of 1 mm, and half of the 0.1 mm in which cameras see.
            off = np.abs(depth_mm[0] / 1000 - arrays["depth"][place, camera])
            assert off.max() < 0.00056


@pytest.mark.parametrize("workers", [0, 2])
def test_a_data_loader_iterates_over_everything(workers: int) -> None:
    torch = import_module("torch")
    loader = torch.utils.data.DataLoader(
        dataset() if workers == 0 else lerobot_dataset(),
        batch_size=16,
        shuffle=True,
        num_workers=workers,
        generator=torch.Generator().manual_seed(0),
    )
    found: list[int] = []
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


def test_statistics_are_those_of_the_frames() -> None:
    stats = dataset().meta.stats
    shown = np.concatenate([seen(n)["rgb"][:, 0] for n in range(4)]) / 255.0
    mean = stats["observation.images.robot_0"]["mean"]
    assert mean.shape == (3, 1, 1)
    assert mean.ravel() == pytest.approx(shown.mean((0, 1, 2)), abs=0.01)
    states = np.concatenate([seen(n)["state"] for n in range(4)])
    assert stats["observation.state"]["mean"] == pytest.approx(states.mean(0), abs=1e-4)
    widest = np.maximum(states.max(0), states.mean(0) + SMALLEST_STD)
    assert stats["observation.state"]["max"] == pytest.approx(widest, abs=1e-4)
    assert stats["observation.state"]["std"].min() >= SMALLEST_STD
    assert stats["action"]["std"].min() >= SMALLEST_STD


def test_what_was_led_by_hand_becomes_a_data_set(tmp_path: Path) -> None:
    known = record(0)
    instance = Instance.from_dict(known.instance_data())
    row = known.subtasks[0]
    names = row.robot, Primitive(row.primitive), row.pick, row.place
    begun = replace(Executed.begin(0.0, SubTask(*names), row.grounded), until_s=2.0)
    episode = Episode(instance)
    done = Teleoperation(instance, "Watch me.", (begun,), (), 3.0, "")
    perform(done, episode)
    last = joints_sha256(episode.simulation.scene.data.qpos)
    (tmp_path / "led").mkdir()
    for name in ("first", "second"):
        path = tmp_path / "led" / f"{name}.json"
        path.write_text(replace(done, end_sha256=last).to_json())
    out = tmp_path / "set"
    words = f"render {tmp_path / 'led'} --form lerobot --size 64x48 --no-depth"
    with pytest.raises(SystemExit) as end:
        main([*words.split(), "--workers", "1", "--out", str(out)])
    assert end.value.code == 0
    module = import_module("lerobot.datasets.lerobot_dataset")
    found = module.LeRobotDataset("lemma/led", root=out, video_backend="pyav")
    assert (found.num_episodes, found.num_frames) == (2, 62)
    item = found[45]
    assert item["task"] == "Watch me."
    assert item["observation.images.robot_0_reach"].shape == (3, 48, 64)
    steps = list(iterate_steps(read_record(path), FPS))
    assert np.allclose(item["action"].numpy(), steps[14].action.ravel(), atol=1e-6)
    assert (out / "extras" / "first.json").is_file()


def test_an_unfinished_shard_is_written_again(tmp_path: Path) -> None:
    source = RenderConfig(recipe=recipe(), out=tmp_path, tasks=("pass",))
    style = Style(width_px=64, height_px=48, depth=False)
    shard = LeRobotConfig(source=source, style=style).shards()[0]
    draft = shard.folder.with_name(f".{shard.folder.name}")
    (draft / "meta").mkdir(parents=True)
    write_shard(shard, style)
    assert shard.folder.is_dir()
    assert not draft.exists()
    rmtree(shard.folder)
