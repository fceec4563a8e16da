"""Generation: the same bytes however they were made, and nothing is lost."""

import errno
import os
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import pytest
from recipes import bytes_of, remembered, small_order, small_recipe

from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.core.files import only_writer, read_json, sha256_of, write_json
from lemma.core.workers.pool import ProcessPool, Serial
from lemma.dataset.files import MANIFEST
from lemma.dataset.recipe import generate as generating
from lemma.dataset.recipe.files import load, open_table, versions
from lemma.dataset.recipe.generate import (
    GenerateConfig,
    generate,
    generate_part,
)
from lemma.dataset.recipe.replay import differing
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS, Instance
from lemma.tasks.suite import SUITE

ABOUT = versions(BENCHMARK_VERSION)


@pytest.fixture(autouse=True)
def _quick_expert(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no episode be played that was played for the small recipe."""
    small_recipe()
    monkeypatch.setattr(generating, "record_episode", remembered)


def test_has_every_episode_of_the_order() -> None:
    recipe = load(small_recipe())
    keys = [row["key"] for row in recipe.rows("key")]
    assert len(keys) == len(set(keys)) == small_order(recipe.folder).total == 12
    assert all(record.success for record in recipe)


@pytest.mark.slow
def test_processes_write_the_same_bytes(tmp_path: Path) -> None:
    summary = generate(small_order(tmp_path), ProcessPool(2))
    assert bytes_of(tmp_path) == bytes_of(small_recipe())
    assert (summary.episodes, summary.made) == (12, 12)
    assert 0 < summary.worker_mb < 500
    size = sum(path.stat().st_size for path in tmp_path.glob("*/*.parquet"))
    assert summary.size_mb == pytest.approx(size / 1e6)


def test_the_order_of_tasks_and_splits_does_not_matter(tmp_path: Path) -> None:
    for split in ("test", "val"):
        for task in ("stack", "pass"):
            some = replace(small_order(tmp_path), tasks=(task,), splits=(split,))
            generate(some, Serial())
    assert bytes_of(tmp_path) == bytes_of(small_recipe())


def test_a_second_run_does_nothing(tmp_path: Path) -> None:
    folder = copytree(small_recipe(), tmp_path / "copy")
    times = {path: path.stat().st_mtime_ns for path in folder.glob("*/*.parquet")}
    counts: list[int] = []
    summary = generate(small_order(folder), Serial(), counts.append)
    assert (counts, summary.made) == ([12], 0)
    assert {p: p.stat().st_mtime_ns for p in folder.glob("*/*.parquet")} == times
    assert bytes_of(folder) == bytes_of(small_recipe())


def test_more_episodes_are_added_to_fewer(tmp_path: Path) -> None:
    order = small_order(tmp_path)
    generate(replace(order, episodes=1), Serial())
    counts: list[int] = []
    assert generate(order, Serial(), counts.append).made == 8
    assert counts == [4] + [1] * 8
    assert bytes_of(tmp_path) == bytes_of(small_recipe())


def test_fewer_episodes_than_there_are_is_refused(tmp_path: Path) -> None:
    folder = copytree(small_recipe(), tmp_path / "copy")
    with pytest.raises(DatasetError, match="more than the requested 2"):
        generate(replace(small_order(folder), episodes=2), Serial())
    assert bytes_of(folder) == bytes_of(small_recipe())


def test_parts_are_taken_up(tmp_path: Path) -> None:
    order = small_order(tmp_path)
    parts = tmp_path / ".parts"
    write_json(parts / "about.json", ABOUT)
    for index in (0, 2):
        path = parts / "val-stack" / f"{index:05d}.parquet"
        generate_part("stack", "val", index, path, ABOUT)
    (parts / "val-stack" / ".00001.parquet.77.draft").write_text("half")
    counts: list[int] = []
    assert generate(order, Serial(), counts.append).made == 10
    assert counts[0] == 2
    assert bytes_of(tmp_path) == bytes_of(small_recipe())


def test_a_full_disk_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room, sync = iter(range(6)), os.fsync

    def fail_later(descriptor: int) -> None:
        if next(room, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail_later)
        with pytest.raises(DatasetError, match="disk is full"):
            generate(small_order(tmp_path), Serial())
    counts: list[int] = []
    generate(small_order(tmp_path), Serial(), counts.append)
    # One of the six writes was the note about versions, one put a file together.
    assert counts[0] == 4
    assert bytes_of(tmp_path) == bytes_of(small_recipe())


def test_a_failing_expert_is_told_and_the_rest_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_once(instance: Instance) -> EpisodeRecord:
        record = remembered(instance)
        if instance.key == f"{BENCHMARK_VERSION}/pass/val/1":
            return replace(record, success=False, failure="dropped")
        return record

    order = replace(small_order(tmp_path), splits=("val",))
    with monkeypatch.context() as patch:
        patch.setattr(generating, "record_episode", fail_once)
        with pytest.raises(
            DatasetError,
            match=rf"1 episodes .*: {BENCHMARK_VERSION}/pass/val/1 .dropped",
        ):
            generate(order, Serial())
    assert not (tmp_path / MANIFEST).exists()
    assert generate(order, Serial()).made == 1


def test_a_part_that_is_not_there_after_all_is_explained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As on a cluster whose machines have disks of their own.
    monkeypatch.setattr(generating, "write_table", lambda *_: None)
    with pytest.raises(DatasetError, match="shared file system"):
        generate(small_order(tmp_path), Serial())


def test_two_runs_in_one_folder_are_refused(tmp_path: Path) -> None:
    with (
        only_writer(tmp_path),
        pytest.raises(DatasetError, match="Another process is writing"),
    ):
        generate(small_order(tmp_path), Serial())


def test_the_manifest_says_what_is_there() -> None:
    folder = small_recipe()
    manifest = read_json(folder / MANIFEST)
    assert manifest["versions"] == ABOUT | {"revision": "of-the-tests"}
    names = {f"{split}/{task}.parquet" for split in ("val", "test") for task in TWO}
    assert set(manifest["files"]) == names
    for name, entry in manifest["files"].items():
        assert entry["sha256"] == sha256_of(folder / name)
        assert entry["episodes"] == len(entry["digests"]) == 3
        assert open_table(folder / name)[1] == manifest["versions"]


TWO = ("pass", "stack")


def test_the_small_recipe_is_what_was_published() -> None:
    assert differing(small_recipe()) == []


def test_a_folder_holds_nothing_but_the_recipe() -> None:
    found = {path.name for path in small_recipe().rglob("*") if path.is_file()}
    assert found == {".lock", "README.md", MANIFEST, "pass.parquet", "stack.parquet"}


def test_the_card_has_the_header_of_the_hub() -> None:
    card = (small_recipe() / "README.md").read_text(encoding="utf-8")
    header = card.split("---\n")[1]
    assert "license: apache-2.0" in header
    assert "path: train/*.parquet" in header
    assert "of-the-tests" in card
    assert "| `keyframe_state` |" in card


def test_an_order_is_checked(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="'stack'"):
        GenerateConfig(out=tmp_path, tasks=("stak",))
    with pytest.raises(UnknownNameError, match="'val'"):
        GenerateConfig(out=tmp_path, splits=("vall",))
    with pytest.raises(InvalidConfigError, match="at least 1"):
        GenerateConfig(out=tmp_path, episodes=0)


def test_everything_is_6400_episodes(tmp_path: Path) -> None:
    assert (
        GenerateConfig(out=tmp_path).total == 6400 == len(SUITE) * sum(SPLITS.values())
    )
    assert GenerateConfig(out=tmp_path, episodes=50).total == len(SUITE) * (
        50 + 40 + 50
    )


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_episodes(tmp_path: Path) -> None:
    peaks = []
    for count in (10, 60):
        order = GenerateConfig(
            out=tmp_path / str(count),
            tasks=("pass",),
            splits=("test",),
            episodes=count,
        )
        peaks.append(generate(order, ProcessPool(1)).worker_mb)
    few, many = peaks
    assert many < 500
    # Nothing is kept per episode; the allocator may round up.
    assert many - few < 20
