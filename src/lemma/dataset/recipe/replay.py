"""Play a recipe again, and compare every state to the bit."""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from lemma.core.errors import DatasetError
from lemma.core.workers.pool import Engine
from lemma.dataset.files import check_files
from lemma.dataset.playback import play_steps
from lemma.dataset.recipe.files import open_table, versions
from lemma.dataset.recipe.reader import Recipe, read_group
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.env.episode import Episode
from lemma.tasks.instance import BENCHMARK_VERSION, Instance

_BINDING = ("format", "benchmark", "mujoco")
"""Versions that must be the same, or states cannot be."""


@dataclass(frozen=True, slots=True)
class Replay:
    """The outcome of a replay."""

    key: str
    drift_at: int | None
    """First keyframe whose state differs; None where all are equal."""
    worst: float
    """Largest difference of any number of that state."""

    @property
    def is_exact(self) -> bool:
        """Whether every state was reproduced to the bit."""
        return self.drift_at is None


def check_versions(about: dict[str, str]) -> None:
    """Check that this installation can reproduce a recipe.

    Raises:
        DatasetError: It was written with another engine or for another benchmark.
    """
    here = versions(BENCHMARK_VERSION)
    for name in _BINDING:
        if about.get(name) != here[name]:
            raise DatasetError(
                f"This recipe was written with {name} {about.get(name)}, and here is "
                f"{here[name]}: states cannot be reproduced. Install that version, or "
                "generate the recipe again."
            )


def replay(record: EpisodeRecord) -> Replay:
    """Execute a record's sub-tasks again and compare with its states."""
    episode = Episode(Instance.from_dict(record.instance_data()))
    scene = episode.simulation.scene
    drifts: list[Replay] = []

    def compare(keyframe: int) -> None:
        written = sha256(record.keyframe_state[keyframe]).hexdigest()
        if not scene.state_hash() == record.keyframe_sha256[keyframe] == written:
            difference = scene.snapshot() - record.state(keyframe)
            worst = float(np.abs(difference).max(initial=0.0))
            drifts.append(Replay(record.key, keyframe, worst))

    play_steps(episode, [row.grounded for row in record.subtasks], compare)
    return drifts[0] if drifts else Replay(record.key, None, 0.0)


def replay_all(
    recipe: Recipe, engine: Engine, advance: Callable[[int], None] = lambda count: None
) -> list[Replay]:
    """Replay the episodes of a recipe.

    Args:
        recipe: The recipe, or a selection of it.
        engine: Workers that run the jobs.
        advance: Is told how many further episodes are done.

    Returns:
        The episodes that drift; empty if all is well.

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
