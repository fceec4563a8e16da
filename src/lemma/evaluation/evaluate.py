"""A policy on a frozen split: one JSON line per episode, resumable.

Episodes are played in groups of fixed composition, because a network's last bits depend
on what else is in its batch. A group is written whole or not at all, so that a killed
run, resumed, gives what an undisturbed one gives.
"""

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from multiprocessing import parent_process
from pathlib import Path
from shutil import rmtree
from time import perf_counter
from typing import Any

from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.dataset.engines import Engine
from lemma.dataset.files import (
    check_same,
    clear_drafts,
    only_writer,
    read_json,
    versions,
    write_json,
    write_whole,
)
from lemma.evaluation.rollout import Play, Player, play_all, subtasks_of
from lemma.policies.specification import PolicySpec
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.suite import SUITE, load_instance
from lemma.tasks.template import KINDS

EPISODES = "episodes.jsonl"
ABOUT = "about.json"
GROUP = 10
"""Episodes that are played together."""
_PARTS = ".parts"

Row = dict[str, Any]
"""One episode, as it stands in the file."""


@dataclass(frozen=True, kw_only=True)
class EvaluationOrder:
    """What to evaluate."""

    out: Path
    """Folder of the result."""
    policy: PolicySpec
    tasks: tuple[str, ...] = SUITE
    split: str = "test"
    kinds: tuple[str, ...] = ("high_level",)
    """Kinds of instructions."""
    episodes: int | None = None
    """Only the first so many of every task; all if None."""

    def __post_init__(self) -> None:
        """Check the names and the number."""
        for task in self.tasks:
            if task not in SUITE:
                raise UnknownNameError("task", task, SUITE)
        if self.split not in SPLITS:
            raise UnknownNameError("split", self.split, SPLITS)
        for kind in self.kinds:
            if kind not in KINDS:
                raise UnknownNameError("kind of instruction", kind, KINDS)
        if self.episodes is not None and self.episodes < 1:
            raise InvalidConfigError(
                f"Episodes per task are 1 or more, not {self.episodes}."
            )

    @property
    def per_task(self) -> int:
        """Episodes per task and kind of instruction."""
        every = SPLITS[self.split]
        return every if self.episodes is None else min(self.episodes, every)

    @property
    def total(self) -> int:
        """Episodes in all."""
        return len(self.tasks) * len(self.kinds) * self.per_task

    def about(self) -> dict[str, Any]:
        """Return what decides the result."""
        return {
            "policy": asdict(self.policy),
            "split": self.split,
            "horizon_s": Play.horizon_s,
            **versions(BENCHMARK_VERSION),
        }

    def groups(self) -> Iterator[tuple[str, str, range]]:
        """Yield kind, task and numbers of the episodes that are played together."""
        for kind in self.kinds:
            for task in self.tasks:
                for start in range(0, self.per_task, GROUP):
                    end = min(start + GROUP, self.per_task)
                    yield kind, task, range(start, end)


def evaluate(
    order: EvaluationOrder,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> list[Row]:
    """Play what is missing, and write the result.

    Args:
        order: What is wanted.
        engine: Where to work.
        advance: Told of episodes that are there.

    Returns:
        All episodes, in the order of kinds, tasks and numbers.

    Raises:
        DatasetError: Something cannot be written, or what is there is of another
            policy or version.
    """
    about = order.about()
    with only_writer(order.out):
        clear_drafts(order.out)
        note = order.out / ABOUT
        if note.exists():
            check_same(note, read_json(note), about)
        else:
            write_json(note, about)
        parts = (order.out / _PARTS).absolute()
        done = {_name(row): row for row in read_rows(order.out)}
        jobs = []
        for kind, task, indices in order.groups():
            path = parts / f"{kind}-{task}-{indices.start}-{indices.stop}.jsonl"
            there = all((kind, task, index) in done for index in indices)
            if there or path.exists():
                advance(len(indices))
            else:
                jobs.append((order.policy, kind, task, order.split, indices, path))
        for count in engine.run(play_group, jobs):
            advance(count)
        for path in sorted(parts.glob("*.jsonl")):
            done.update((_name(row), row) for row in _read(path))
        rows = sorted(done.values(), key=_place)
        _write(order.out / EPISODES, rows)
        rmtree(parts, ignore_errors=True)
    wanted = {
        (kind, task, index)
        for kind, task, indices in order.groups()
        for index in indices
    }
    return [row for row in rows if _name(row) in wanted]


def read_rows(folder: Path) -> list[Row]:
    """Return the episodes of a result; none if there is none yet.

    Raises:
        DatasetError: The file is damaged.
    """
    path = folder / EPISODES
    return _read(path) if path.exists() else []


def play_group(
    spec: PolicySpec, kind: str, task: str, split: str, indices: range, path: Path
) -> int:
    """Play some episodes, write them, and return how many they are."""
    player = _player(spec)
    plays = [Play(load_instance(task, split, i), kind) for i in indices]
    start = perf_counter()
    over = list(play_all(plays, player, len(plays)))
    wall_s = (perf_counter() - start) / len(over)
    rows = sorted((_row(play, kind, wall_s) for play in over), key=_place)
    _write(path, rows)
    return len(rows)


@lru_cache(maxsize=1)
def _player(spec: PolicySpec) -> Player:
    """Return the policy of this process: loading one takes long."""
    player = Player.load(spec)
    if parent_process() is not None and "torch" in sys.modules:
        # There is a process per core; more threads would fight for them.
        sys.modules["torch"].set_num_threads(1)
    return player


def _row(play: Play, kind: str, wall_s: float) -> Row:
    instance, episode = play.instance, play.episode
    info = episode.info()
    return {
        "task": instance.task,
        "split": instance.split,
        "index": instance.index,
        "team": instance.team,
        "distractors": len(instance.distractors),
        "instruction_kind": kind,
        "instruction": instance.instructions[kind],
        "success": info["success"],
        "progress": info["progress"],
        "failure": info["failure"],
        "elapsed_s": round(info["elapsed_s"], 3),
        "idle_s": {name: round(idle, 3) for name, idle in info["idle_s"].items()},
        "subtasks": subtasks_of(play.steps),
        "wall_s": round(wall_s, 3),
    }


def _name(row: Row) -> tuple[str, str, int]:
    return row["instruction_kind"], row["task"], row["index"]


def _place(row: Row) -> tuple[int, int, int]:
    kind, task, index = _name(row)
    return KINDS.index(kind), SUITE.index(task), index


def _read(path: Path) -> list[Row]:
    try:
        return [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    except (OSError, json.JSONDecodeError) as error:
        raise DatasetError(
            f"{path} cannot be read: {error}. Remove it and evaluate again."
        ) from error


def _write(path: Path, rows: list[Row]) -> None:
    text = "".join(json.dumps(row) + "\n" for row in rows)
    write_whole(path, lambda draft: _write_text(draft, text))


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
