"""The recipe: the same bytes however it was made, and states that replay to the bit."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.dataset.digests import expected_digests, shorten
from lemma.dataset.engines import Processes, Serial
from lemma.dataset.files import check_files, sha256_of
from lemma.dataset.generate import Order, generate, recipe_file
from lemma.dataset.reader import Recipe, load
from lemma.dataset.record import record_episode
from lemma.dataset.replay import check_versions, replay
from lemma.dataset.schema import from_table, to_table
from lemma.tasks.instance import SPLITS
from lemma.tasks.suite import SUITE, load_instance

SAMPLE = 40
KILLS = 6


def order(out: Path) -> Order:
    return Order(out=out, tasks=("pass", "stack"), splits=("val", "test"), episodes=3)


def bytes_of(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): sha256_of(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module", autouse=True)
def revision() -> Iterator[None]:
    # Somebody may commit while the tests run; files name the revision they come from.
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LEMMA_REVISION", "test")
        yield


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Recipe:
    folder = tmp_path_factory.mktemp("recipe")
    generate(order(folder), Serial())
    return load(folder)


def test_has_every_episode_of_the_order(recipe: Recipe) -> None:
    keys = {header.key for header in recipe.headers()}
    assert len(recipe) == len(keys) == order(recipe.folder).total == 12
    assert recipe.find("stack", "test", 2).index == 2
    assert all(record.success for record in recipe)


def test_round_trip(recipe: Recipe) -> None:
    records = list(recipe)
    assert from_table(to_table(records)) == records


def test_processes_write_the_same_bytes(recipe: Recipe, tmp_path: Path) -> None:
    generate(order(tmp_path), Processes(2))
    assert bytes_of(tmp_path) == bytes_of(recipe.folder)


def test_a_second_run_changes_nothing(recipe: Recipe) -> None:
    before = bytes_of(recipe.folder)
    generate(order(recipe.folder), Serial())
    assert bytes_of(recipe.folder) == before


@pytest.mark.slow
def test_killed_at_any_moment_it_ends_with_the_same_bytes(
    recipe: Recipe, tmp_path: Path
) -> None:
    folder = tmp_path / "killed"
    words = ["generate", "--tasks", "pass,stack", "--split", "val,test"]
    words += ["--episodes", "3", "--out", str(folder), "--workers", "2"]
    script = f"from lemma.cli.main import main; main({words!r})"
    rng = np.random.default_rng(0)
    for _ in range(KILLS):
        process = subprocess.Popen(
            [sys.executable, "-c", script],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        time.sleep(rng.uniform(0.5, 5.0))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    generate(order(folder), Serial())
    assert bytes_of(folder) == bytes_of(recipe.folder)


def test_every_state_replays_to_the_bit(recipe: Recipe) -> None:
    for record in (recipe.find("pass", "val", 0), recipe.find("stack", "test", 1)):
        assert replay(record).is_exact


def test_a_replay_that_drifts_says_where(recipe: Recipe) -> None:
    record = recipe.find("stack", "val", 0)
    hashes = list(record.keyframe_sha256)
    state = record.state(1).copy()
    state[5] += 1e-9
    hashes[1] = "0" * 64
    states = [*record.keyframe_state]
    states[1] = state.tobytes()
    drifted = replay(
        replace(record, keyframe_sha256=tuple(hashes), keyframe_state=tuple(states))
    )
    assert drifted.drift_at == 1
    assert drifted.worst == pytest.approx(1e-9, rel=1e-3)


def test_another_engine_is_refused(recipe: Recipe) -> None:
    about = {"format": "1", "benchmark": "v1", "mujoco": "4.0.0"}
    with pytest.raises(DatasetError, match="mujoco"):
        check_versions(about)


def test_a_truncated_file_is_named(recipe: Recipe, tmp_path: Path) -> None:
    source = recipe_file(recipe.folder, "val", "pass")
    path = tmp_path / "val" / "pass.parquet"
    path.parent.mkdir()
    path.write_bytes(source.read_bytes()[:-200])
    with pytest.raises(DatasetError, match=r"pass\.parquet"):
        load(tmp_path)


def test_a_changed_file_fails_its_checksum(tmp_path: Path) -> None:
    small = Order(out=tmp_path, tasks=("pass",), splits=("val",), episodes=1)
    generate(small, Serial())
    check_files(tmp_path)
    path = recipe_file(tmp_path, "val", "pass")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(DatasetError, match=r"pass\.parquet"):
        check_files(tmp_path)


def test_an_empty_folder_is_no_recipe(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="lemma generate"):
        load(tmp_path)


def test_unknown_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="stack"):
        Order(out=tmp_path, tasks=("stak",))
    with pytest.raises(UnknownNameError, match="val"):
        Order(out=tmp_path, splits=("validation",))


def test_reading_needs_neither_mujoco_nor_torch(recipe: Recipe) -> None:
    script = (
        "import sys\n"
        "sys.modules['mujoco'] = sys.modules['torch'] = None\n"
        "from lemma.dataset.reader import load\n"
        f"print(len(load({str(recipe.folder)!r})[3].keyframe_state))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(recipe[3].keyframes)


def test_digests_cover_every_frozen_episode() -> None:
    for task in SUITE:
        for split, count in SPLITS.items():
            assert len(set(expected_digests(task, split))) == count


@pytest.mark.slow
def test_a_sample_of_the_suite_comes_out_to_the_bit() -> None:
    rng = np.random.default_rng(20260101)
    lists = [(task, split) for task in SUITE for split in SPLITS]
    for k in range(SAMPLE):
        task, split = lists[k % len(lists)]
        index = int(rng.integers(SPLITS[split]))
        record = record_episode(load_instance(task, split, index))
        assert shorten(record.digest()) == expected_digests(task, split)[index]
