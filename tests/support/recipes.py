"""Recipes for tests: a real one of a few episodes, and made-up records."""

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from kept import kept_folder

from lemma.core.files import sha256_of, write_json
from lemma.core.workers.pool import Serial
from lemma.dataset.files import MANIFEST, content_digest, shorten
from lemma.dataset.recipe.files import load, versions, write_table
from lemma.dataset.recipe.generate import GenerateConfig, generate, recipe_file
from lemma.dataset.recipe.record import record_episode
from lemma.dataset.recipe.schema import EpisodeRecord, SubTaskRecord, to_table
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.suite import load_instance

TASKS = ("pass", "stack")
SPLITS = ("val", "test")
EPISODES = 3


def small_order(out: Path) -> GenerateConfig:
    """Return an order of twelve short episodes."""
    return GenerateConfig(out=out, tasks=TASKS, splits=SPLITS, episodes=EPISODES)


def small_recipe() -> Path:
    """Return a recipe of that order, made once; do not write there."""
    return kept_folder("recipe", lambda out: generate(small_order(out), Serial()))


def remembered(instance: Instance) -> EpisodeRecord:
    """Return the expert's record, from the small recipe if that has it."""
    return _remembered().get(instance.key) or record_episode(instance)


@cache
def _remembered() -> dict[str, EpisodeRecord]:
    return {record.key: record for record in load(small_recipe())}


def bytes_of(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file in a folder."""
    return {
        path.relative_to(folder).as_posix(): sha256_of(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Path]:
    """Give a file system of its own, or skip the test where none may be mounted."""
    folder.mkdir()
    size = f"size={kilobytes}k"
    command = ["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(folder)]
    if (
        sys.platform != "linux"
        or subprocess.run(command, capture_output=True).returncode
    ):
        pytest.skip("mounting a small disk takes root and Linux")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def remount(folder: Path, options: str) -> None:
    """Change the size of such a file system, or whether it may be written to."""
    subprocess.run(["mount", "-o", f"remount,{options}", str(folder)], check=True)


def made_up(
    task: str = "stack", split: str = "val", index: int = 0, keyframes: int = 3
) -> EpisodeRecord:
    """Return a record of a frozen instance whose states are random numbers."""
    instance = load_instance(task, split, index)
    rng = np.random.default_rng(index)
    states = tuple(rng.random(50).tobytes() for _ in range(keyframes))
    row = SubTaskRecord(
        robot="robot_0",
        primitive="move",
        pick=instance.goal.pairs[0][0],
        place=instance.goal.pairs[0][1],
        instruction="left robot: move it",
        pick_pose=(0.1, -0.2, 0.3),
        place_pose=(0.0, 0.1, -0.3),
        outcome="success",
        start_s=0.0,
        duration_s=5.5,
    )
    return EpisodeRecord(
        key=instance.key,
        task=task,
        split=split,
        index=index,
        team=instance.team,
        distractors=len(instance.distractors),
        high_level=instance.instructions["high_level"],
        human=instance.instructions["human"],
        unseen=instance.instructions["unseen"],
        instance=json.dumps(instance.to_dict(), sort_keys=True, separators=(",", ":")),
        instance_sha256=instance.sha256(),
        subtasks=(row,) * (keyframes - 1),
        keyframe_time_s=tuple(5.5 * i for i in range(keyframes)),
        keyframe_state=states,
        keyframe_sha256=tuple(hashlib.sha256(state).hexdigest() for state in states),
        success=True,
        progress=1.0,
        failure=None,
        elapsed_s=5.5 * (keyframes - 1),
        idle_s=(0.0, 5.5 * (keyframes - 1)),
    )


def write_recipe(
    folder: Path, records: list[EpisodeRecord], about: dict[str, str] | None = None
) -> Path:
    """Write records of one task and split, with a manifest that fits; return the file.

    Args:
        folder: The recipe.
        records: The episodes.
        about: The file's description of itself; the present versions if None.
    """
    about = about or versions(BENCHMARK_VERSION)
    path = recipe_file(folder, records[0].split, records[0].task)
    write_table(path, to_table(records), about)
    digests = [shorten(record.digest()) for record in records]
    entry = {
        "sha256": sha256_of(path),
        "content_sha256": content_digest(digests),
        "episodes": len(records),
        "digests": digests,
    }
    name = path.relative_to(folder).as_posix()
    write_json(folder / MANIFEST, {"versions": about, "files": {name: entry}})
    return path
