"""Replays: exact where nothing changed, and precise about what did."""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from recipes import small_recipe, write_recipe

from lemma.core.errors import DatasetError
from lemma.core.workers.pool import ProcessPool, Serial
from lemma.dataset.recipe.files import load, versions
from lemma.dataset.recipe.replay import check_versions, replay, replay_all
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.tasks.instance import BENCHMARK_VERSION


def record() -> EpisodeRecord:
    return load(small_recipe()).find("stack", "val", 0)


@pytest.mark.slow
def test_every_state_is_reproduced_to_the_bit() -> None:
    counts: list[int] = []
    # One of each task and split.
    assert replay_all(load(small_recipe())[::3], Serial(), counts.append) == []
    assert sum(counts) == 4


@pytest.mark.slow
def test_processes_replay_as_well() -> None:
    recipe = load(small_recipe()).select(task="stack", split="test")
    assert replay_all(recipe[1:], ProcessPool(2)) == []


def test_a_changed_state_is_found_and_measured() -> None:
    state = record().state(1).copy()
    state[5] += 1e-9
    states = list(record().keyframe_state)
    hashes = list(record().keyframe_sha256)
    states[1], hashes[1] = state.tobytes(), sha256(state.tobytes()).hexdigest()
    changed = replace(
        record(), keyframe_state=tuple(states), keyframe_sha256=tuple(hashes)
    )
    found = replay(changed)
    assert (found.key, found.drift_at, found.is_exact) == (changed.key, 1, False)
    assert found.worst == pytest.approx(1e-9, rel=1e-3)


def test_a_state_that_does_not_fit_its_hash_is_found() -> None:
    states = list(record().keyframe_state)
    states[2] = states[0]
    found = replay(replace(record(), keyframe_state=tuple(states)))
    assert found.drift_at == 2
    assert found.worst > 0


def test_a_changed_subtask_drifts_where_it_ends() -> None:
    rows = list(record().subtasks)
    x, y, yaw = rows[1].place_pose
    rows[1] = replace(rows[1], place_pose=(float(np.nextafter(x, 9)), y, yaw))
    assert replay(replace(record(), subtasks=tuple(rows))).drift_at == 2


def test_a_changed_scene_drifts_from_the_start() -> None:
    data = record().instance_data()
    data["objects"][0][2] += 1e-4
    found = replay(replace(record(), instance=json.dumps(data)))
    assert found.drift_at == 0
    assert 1e-5 < found.worst < 1e-2


@pytest.mark.slow
def test_all_drifting_episodes_are_returned(tmp_path: Path) -> None:
    good = [load(small_recipe()).find("stack", "val", i) for i in range(3)]
    bad = [replace(r, keyframe_sha256=("0" * 64,) * r.keyframes) for r in good[:2]]
    write_recipe(tmp_path, [bad[0], good[2], bad[1]])
    found = replay_all(load(tmp_path), Serial())
    assert [drift.key for drift in found] == [bad[0].key, bad[1].key]
    assert all(drift.drift_at == 0 for drift in found)


@pytest.mark.parametrize("name", ["mujoco", "benchmark", "format"])
def test_another_version_is_refused_before_anything_is_replayed(name: str) -> None:
    about = {**versions(BENCHMARK_VERSION), name: "0"}
    with pytest.raises(DatasetError, match=rf"written with {name} 0, but .* is"):
        check_versions(about)


def test_another_numpy_is_not_refused() -> None:
    check_versions(
        {**versions(BENCHMARK_VERSION), "numpy": "0", "numba": "0", "revision": "?"}
    )
