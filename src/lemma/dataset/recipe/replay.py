"""Replay of a recipe, and comparison with the published digests.

A replay compares every state bit for bit. The package contains a digest of 128 bits of
every episode of the suites, so a recipe of the frozen lists can be compared with the
published one without a download.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.core.workers.pool import Engine
from lemma.dataset.files import check_files, listed_files
from lemma.dataset.playback import Watcher, play_steps, unwatched
from lemma.dataset.recipe.files import Recipe, open_table, read_group, versions
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.env.episode import Episode
from lemma.env.team.orders import Team
from lemma.planning.geometry import GroundedOption
from lemma.scene.build import TIME_STEP_S
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.subtask import Primitive, SubTask

_HERE = files("lemma.dataset") / "digests"
_BINDING = ("format", "benchmark", "mujoco")
"""Versions that must be equal for equal states."""


@dataclass(frozen=True, slots=True)
class Replay:
    """The outcome of a replay."""

    key: str
    drift_at: int | None
    """Index of the first keyframe with a different state; None if all are equal."""
    worst: float
    """Largest absolute difference of the numbers of that state."""

    @property
    def is_exact(self) -> bool:
        """Whether every state was reproduced bit for bit."""
        return self.drift_at is None


def check_versions(about: dict[str, str]) -> None:
    """Check that this installation can reproduce a recipe.

    Raises:
        DatasetError: The recipe has another version of engine, format or benchmark.
    """
    here = versions(BENCHMARK_VERSION)
    for name in _BINDING:
        if about.get(name) != here[name]:
            raise DatasetError(
                f"This recipe was written with {name} {about.get(name)}, but "
                f"{here[name]} is installed, so states cannot be reproduced. Install "
                "that version, or generate the recipe again."
            )


def replay(record: EpisodeRecord) -> Replay:
    """Execute a record's sub-tasks again, and compare the states with its own."""
    episode = Episode(Instance.from_dict(record.instance_data()))
    scene = episode.simulation.scene
    drifts: list[Replay] = []

    def compare(keyframe: int) -> None:
        written = hashlib.sha256(record.keyframe_state[keyframe]).hexdigest()
        if not scene.state_hash() == record.keyframe_sha256[keyframe] == written:
            difference = scene.snapshot() - record.state(keyframe)
            worst = float(np.abs(difference).max(initial=0.0))
            drifts.append(Replay(record.key, keyframe, worst))

    play_record(episode, record, compare)
    return drifts[0] if drifts else Replay(record.key, None, 0.0)


def play_record(
    episode: Episode, record: EpisodeRecord, before: Watcher = unwatched
) -> None:
    """Execute a record's sub-tasks: in turns, or each at the time at which it began.

    Args:
        episode: An episode of the record's instance, in its initial state.
        record: The record.
        before: Called with the number of each sub-task before it begins, and with the
            number of sub-tasks at the end.
    """
    if episode.instance.goal.in_turns:
        play_steps(episode, [row.grounded for row in record.subtasks], before)
        return
    team = Team(episode)
    for number, row in enumerate(record.subtasks):
        until_s = row.start_s - 0.5 * TIME_STEP_S
        while team.orders and episode.simulation.time_s < until_s:
            team.pass_time(row.start_s)
        before(number)
        primitive, now = Primitive(row.primitive), team.observe()
        subtask = SubTask(row.robot, primitive, row.pick, row.place)
        # Its effect, quality and duration are of no account here.
        team.begin(GroundedOption(subtask, row.grounded, now, 0.0, 0.0), now)
    while team.orders:
        team.pass_time()
    before(len(record.subtasks))


def replay_all(
    recipe: Recipe, engine: Engine, advance: Callable[[int], None] = lambda count: None
) -> list[Replay]:
    """Replay the episodes of a recipe.

    Args:
        recipe: The recipe, or a selection of it.
        engine: Workers that run the jobs.
        advance: Called with the number of newly finished episodes.

    Returns:
        The outcomes of the episodes that drift; empty if all are exact.

    Raises:
        DatasetError: A file is damaged, or of another version.
    """
    check_files(recipe.folder)
    for path in recipe.files():
        check_versions(open_table(path)[1])
    drifting = []
    jobs = [(path.absolute(), *rest) for path, *rest in recipe.groups()]
    for replays in engine.run(replay_group, jobs):
        drifting += [found for found in replays if not found.is_exact]
        advance(len(replays))
    return drifting


def replay_group(path: Path, group: int, rows: tuple[int, ...]) -> list[Replay]:
    """Replay some episodes of one row group of a file."""
    records = read_group(path, group)
    return [replay(records[row]) for row in rows]


def differing(folder: Path) -> list[str] | None:
    """Return the episodes of a recipe that differ from the published ones.

    Args:
        folder: The recipe.

    Returns:
        Task, split and index of each, such as ``"stack/test/3"``; empty if all are
        equal; None if no list of the recipe is published, such as for a user-defined
        task.
    """
    found: list[str] | None = None
    for name, entry in listed_files(folder).items():
        split, _, task = name.removesuffix(".parquet").partition("/")
        if not (_HERE / f"{task}-{split}.txt").is_file():
            continue
        pairs = zip(entry["digests"], expected_digests(task, split), strict=False)
        others = [i for i, (mine, theirs) in enumerate(pairs) if mine != theirs]
        found = [*(found or []), *(f"{task}/{split}/{i}" for i in others)]
    return found


@lru_cache
def expected_digests(task: str, split: str) -> tuple[str, ...]:
    """Return the published digests of the episodes of a task and split, in order.

    Raises:
        UnknownNameError: There is no such list.
    """
    source = _HERE / f"{task}-{split}.txt"
    if not source.is_file():
        names = sorted(p.name.removesuffix(".txt") for p in _HERE.iterdir())
        raise UnknownNameError("list of digests", f"{task}-{split}", names)
    return tuple(source.read_text(encoding="ascii").split())
