"""A LeRobotDataset is what the format says, read here as its readers do."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot_sets import FPS, ROBOTS, STYLE, VIDEOS, decode_at, folder, psnr_db, written
from rendered_sets import SPLIT, recipe

from lemma.dataset.files import REVISION_VARIABLE, check_files
from lemma.dataset.recipe.reader import load
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.steps import DenseStep, count_steps, iterate_steps
from lemma.scene.rendering.renderer import Renderer


@pytest.fixture(autouse=True)
def _one_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REVISION_VARIABLE, "of-the-tests")


def info() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder() / "meta/info.json").read_text())
    return found


@cache
def episodes() -> list[dict[str, Any]]:
    paths = sorted((folder() / "meta/episodes").glob("*/*.parquet"))
    return [row for path in paths for row in pq.read_table(path).to_pylist()]


def record_of(row: dict[str, Any]) -> EpisodeRecord:
    return recipe().find(row["lemma/task"], row["lemma/split"], row["lemma/index"])


def frames(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the frames of an episode, found as a reader finds them."""
    path = folder() / info()["data_path"].format(
        chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
    )
    listed: list[dict[str, Any]] = [
        frame
        for frame in pq.read_table(path).to_pylist()
        if row["dataset_from_index"] <= frame["index"] < row["dataset_to_index"]
    ]
    return listed


def video_of(row: dict[str, Any], key: str) -> Path:
    name = info()["video_path"].format(
        video_key=key,
        chunk_index=row[f"videos/{key}/chunk_index"],
        file_index=row[f"videos/{key}/file_index"],
    )
    return folder() / name


@pytest.mark.render
def test_the_whole_says_how_much_there_is() -> None:
    told = info()
    lengths = [row["length"] for row in episodes()]
    assert told["codebase_version"] == "v3.0"
    assert told["fps"] == FPS
    assert told["total_episodes"] == len(episodes()) == 4
    assert told["total_frames"] == sum(lengths) == written()[1].rows
    assert told["splits"] == {SPLIT: "0:4"}
    assert written()[1].episodes == written()[1].made == 4
    for row in episodes():
        assert row["length"] == count_steps(record_of(row), FPS)
    assert not (folder() / ".parts").exists()


@pytest.mark.render
def test_features_are_the_columns_of_the_frames() -> None:
    listed = info()["features"]
    videos = {name for name, feature in listed.items() if feature["dtype"] == "video"}
    assert videos == set(VIDEOS)
    assert {path.name for path in (folder() / "videos").iterdir()} == videos
    paths = sorted((folder() / "data").rglob("*.parquet"))
    assert len(paths) > 1
    types = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
    for path in paths:
        schema = pq.read_schema(path)
        assert set(schema.names) == set(listed) - videos
        for field in schema:
            feature = listed[field.name]
            size, kind = feature["shape"][0], types[feature["dtype"]]
            assert field.type == (kind if size == 1 else pa.list_(kind, size))
            assert feature["names"] is None or len(feature["names"]) == size
    motors = listed["action"]["names"]
    assert motors == listed["observation.state"]["names"]
    assert len(motors) == len(set(motors)) == 14
    assert motors[0] == "robot_0.shoulder_pan"
    assert motors[-1] == "robot_1.gripper"


@pytest.mark.render
def test_frames_are_numbered_through() -> None:
    start = 0
    for number, row in enumerate(episodes()):
        assert row["episode_index"] == number
        assert row["dataset_from_index"] == start
        rows = frames(row)
        start += row["length"]
        assert row["dataset_to_index"] == start
        assert [frame["frame_index"] for frame in rows] == list(range(row["length"]))
        assert {frame["episode_index"] for frame in rows} == {number}
        times = [frame["timestamp"] for frame in rows]
        assert times == pytest.approx([i / FPS for i in range(len(rows))], abs=1e-5)


@pytest.mark.render
def test_frames_hold_the_steps() -> None:
    for row in episodes()[::3]:
        record = record_of(row)
        for frame, step in zip(frames(row), steps(record), strict=True):
            state = np.concatenate([step.joints, step.opening_m[:, None]], axis=1)
            assert frame["observation.state"] == pytest.approx(state.ravel(), abs=1e-6)
            assert frame["action"] == pytest.approx(step.action.ravel(), abs=1e-6)
            assert frame["next.reward"] == step.reward
            assert frame["next.done"] is step.is_done
            assert frame["next.success"] is (step.is_done and record.success)


@cache
def steps(record: EpisodeRecord) -> tuple[DenseStep, ...]:
    # Their scene is one and the same, and stands at the last of them.
    return tuple(iterate_steps(record, FPS))


@pytest.mark.render
def test_sentences_are_found_by_their_numbers() -> None:
    table = pq.read_table(folder() / "meta/tasks.parquet")
    tasks = dict(enumerate(table["task"].to_pylist()))
    assert table["task_index"].to_pylist() == list(tasks)
    assert list(tasks) == list(range(info()["total_tasks"]))
    pandas = json.loads(table.schema.metadata[b"pandas"])
    assert pandas["index_columns"] == ["task"]
    table = pq.read_table(folder() / "meta/subtasks.parquet")
    subtasks = dict(enumerate(table["subtask"].to_pylist()))
    assert table["subtask_index"].to_pylist() == list(subtasks)
    for row in episodes():
        record = record_of(row)
        assert row["tasks"] == [record.high_level]
        assert row["lemma/subtasks"] == [each.instruction for each in record.subtasks]
        for frame, step in zip(frames(row), steps(record), strict=True):
            assert tasks[frame["task_index"]] == record.high_level
            for kind in ("high_level", "human", "unseen"):
                number = frame[f"annotation.instruction.{kind}"]
                assert tasks[number] == getattr(record, kind) == row[f"lemma/{kind}"]
            words = subtasks[frame["subtask_index"]]
            if not step.is_done:
                assert words == record.subtasks[step.subtask].instruction
        assert words not in row["lemma/subtasks"]


@pytest.mark.render
def test_videos_have_every_frame_at_its_time() -> None:
    several = False
    for key in VIDEOS:
        for path in sorted((folder() / "videos" / key).rglob("*.mp4")):
            rows = [row for row in episodes() if video_of(row, key) == path]
            several = several or len(rows) > 1
            with av.open(str(path)) as container:
                times = [frame.time for frame in container.decode(video=0)]
                stream = container.streams.video[0]
                assert stream.average_rate == FPS
                assert stream.codec.canonical_name == codec_of(key)
            count = sum(row["length"] for row in rows)
            assert times == pytest.approx([i / FPS for i in range(count)])
            begin = 0.0
            for row in rows:
                assert row[f"videos/{key}/from_timestamp"] == pytest.approx(begin)
                begin += row["length"] / FPS
                assert row[f"videos/{key}/to_timestamp"] == pytest.approx(begin)
    assert several
    assert len({row[f"videos/{VIDEOS[0]}/file_index"] for row in episodes()}) > 1


def codec_of(key: str) -> str:
    codec: str = info()["features"][key]["info"]["video.codec"]
    return codec


@pytest.mark.render
def test_frames_of_videos_are_what_the_cameras_saw() -> None:
    renderer = Renderer(STYLE.width_px, STYLE.height_px)
    # The first of a file, and one that comes after another.
    for row in episodes()[:2]:
        picked = {3, 11, row["length"] - 1}
        shots = {
            step.index: [
                renderer.rgbd(step.scene.model, step.scene.data, f"{robot}/camera")
                for robot in ROBOTS
            ]
            for step in iterate_steps(record_of(row), FPS)
            if step.index in picked
        }
        for camera, robot in enumerate(ROBOTS):
            key = f"observation.images.{robot}"
            begin = row[f"videos/{key}/from_timestamp"]
            times = [begin + index / FPS for index in shots]
            colors = decode_at(video_of(row, key), times, "rgb24")
            for shot, theirs in zip(shots.values(), colors, strict=True):
                assert psnr_db(shot[camera].rgb, theirs) > 30
            key += "_depth"
            begin = row[f"videos/{key}/from_timestamp"]
            times = [begin + index / FPS for index in shots]
            depths = decode_at(video_of(row, key), times, "gray12le")
            for shot, levels in zip(shots.values(), depths, strict=True):
                told = info()["features"][key]["info"]
                assert told["is_depth_map"] is True
                assert told["video.use_log"] is False
                span = told["video.depth_max"] - told["video.depth_min"]
                theirs = told["video.depth_min"] + levels / 4095 * span
                off = np.abs(theirs - shot[camera].depth_m)
                assert off.max() <= 0.000501


@pytest.mark.render
def test_cameras_are_calibrated() -> None:
    row = episodes()[1]
    step = next(iter(iterate_steps(record_of(row), FPS)))
    renderer = Renderer(STYLE.width_px, STYLE.height_px)
    camera = renderer.rgbd(step.scene.model, step.scene.data, "robot_1/camera").camera
    fx, fy, cx, cy = row["camera/robot_1/intrinsics"]
    assert np.array_equal(
        [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], camera.intrinsics.matrix()
    )
    pose = np.reshape(row["camera/robot_1/world_from_camera"], (4, 4))
    assert np.array_equal(pose, camera.world_from_camera.matrix())


@pytest.mark.render
def test_statistics_are_those_of_the_frames() -> None:
    stats = json.loads((folder() / "meta/stats.json").read_text())
    assert set(stats) == set(info()["features"])
    every = [frame for row in episodes() for frame in frames(row)]
    for name in sorted(set(stats) - set(VIDEOS)):
        values = np.array([frame[name] for frame in every], float).reshape(
            len(every), -1
        )
        assert stats[name]["count"] == [len(every)]
        for figure in ("min", "max", "mean", "std"):
            expected = getattr(values, figure)(axis=0)
            assert stats[name][figure] == pytest.approx(expected, abs=1e-9)
        for row in episodes():
            mine = values[row["dataset_from_index"] : row["dataset_to_index"]]
            assert row[f"stats/{name}/q90"] == pytest.approx(
                np.quantile(mine, 0.9, axis=0), abs=1e-9
            )


@pytest.mark.render
def test_statistics_of_pictures_are_those_of_their_pixels() -> None:
    row = episodes()[0]
    key = "observation.images.robot_1_depth"
    times = [index / FPS for index in range(row["length"])]
    levels = np.stack(decode_at(video_of(row, key), times, "gray12le"))
    depth_m = levels[:, ::2, ::2] * 0.001
    assert row[f"stats/{key}/count"] == [row["length"]]
    for figure in ("min", "max", "mean", "std"):
        expected = getattr(depth_m, figure)()
        assert row[f"stats/{key}/{figure}"] == [[[pytest.approx(expected)]]]
    assert row[f"stats/{key}/q10"] == [[[pytest.approx(np.quantile(depth_m, 0.1))]]]
    color = row["stats/observation.images.robot_0/mean"]
    assert np.shape(color) == (3, 1, 1)
    assert 0 < np.min(color) < np.max(color) < 1


@pytest.mark.render
def test_extras_are_the_recipe() -> None:
    extras = folder() / "extras"
    check_files(extras)
    assert list(load(extras)) == list(recipe())
