"""The LeRobot form: counts, offsets and videos agree with each other."""

import json
from pathlib import Path

import av
import pyarrow.parquet as pq
import pytest

from lemma.dataset.engines import Serial
from lemma.dataset.generate import Order, generate
from lemma.dataset.lerobot import export
from lemma.dataset.reader import load

FPS = 2


@pytest.mark.render
@pytest.mark.slow
def test_tables_and_videos_agree(tmp_path: Path) -> None:
    recipe, out = tmp_path / "recipe", tmp_path / "lerobot"
    generate(Order(out=recipe, tasks=("pass",), splits=("val",), episodes=2), Serial())
    export(recipe, out, FPS)
    info = json.loads((out / "meta" / "info.json").read_text())
    frames = pq.read_table(out / "data")
    episodes = pq.read_table(out / "meta" / "episodes")
    assert info["codebase_version"] == "v3.0"
    assert info["total_episodes"] == episodes.num_rows == 2
    assert (
        info["total_frames"] == frames.num_rows == sum(episodes["length"].to_pylist())
    )
    starts = episodes["dataset_from_index"].to_pylist()
    ends = episodes["dataset_to_index"].to_pylist()
    assert starts[1] == ends[0]
    assert ends[1] == frames.num_rows
    for length, record in zip(
        episodes["length"].to_pylist(), load(recipe), strict=True
    ):
        assert abs(length - record.elapsed_s * FPS) <= 2
    assert set(frames["episode_index"].to_pylist()) == {0, 1}
    width = info["features"]["observation.state"]["shape"][0]
    assert {len(row) for row in frames["observation.state"].to_pylist()} == {width}
    for key in ("observation.images.robot_0", "observation.images.robot_1"):
        (path,) = (out / "videos" / key).rglob("*.mp4")
        with av.open(str(path)) as video:
            assert sum(1 for _ in video.decode(video=0)) == frames.num_rows
