"""The form ``dense``: every step of an episode, at a rate, without pictures."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lemma.core.robot_names import robot_names
from lemma.dataset.files import write_whole
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.dense_schema import (
    DENSE_VERSION,
    FOLDER,
    FORM,
    SUFFIX,
    DenseHeader,
    describe,
    open_steps,
)
from lemma.dataset.rendered.labels import entity_poses, label
from lemma.dataset.rendered.render import Found
from lemma.dataset.rendered.steps import DenseStep, iterate_steps, ticks_per_step
from lemma.robots.ur.build import JOINTS
from lemma.scene.objects.entity import known_entities

_PER_FILE = ("channels", "digests")


@dataclass(frozen=True, slots=True)
class DenseForm:
    """States and commands between keyframes, for policies that control."""

    hz: int = 10
    """Steps per simulated second."""

    def __post_init__(self) -> None:
        """Check the rate."""
        ticks_per_step(self.hz)

    @property
    def name(self) -> str:
        """Name of the form."""
        return FORM

    def paths(self, split: str, name: str) -> tuple[str, ...]:
        """Return the file of a row group of the recipe."""
        return (f"{FOLDER}/{split}/{name}{SUFFIX}",)

    def about(self, versions: dict[str, str]) -> dict[str, Any]:
        """Return what decides the bytes, beside the episodes."""
        return _shared(
            DenseHeader(FORM, DENSE_VERSION, versions, self.hz, known_entities())
        )

    def look(self, path: Path) -> Found:
        """Return what a file says about itself.

        Raises:
            DatasetError: It is damaged, or of another form or version.
        """
        file, header = open_steps(path)
        return Found(_shared(header), header.digests, file.metadata.num_rows)

    def write(
        self,
        paths: Sequence[Path],
        records: Sequence[EpisodeRecord],
        digests: tuple[str, ...],
        about: dict[str, Any],
    ) -> None:
        """Execute some episodes again and write down their steps.

        Args:
            paths: The file.
            records: The episodes.
            digests: Their digests in the recipe.
            about: What :meth:`about` returned.

        Raises:
            DatasetError: The motion is not the recorded one, or the file cannot be
                written.
        """
        robots = len(records[0].instance_data()["robots"])
        channels = tuple(
            f"{robot}/{name}"
            for robot in robot_names(robots)
            for name in (*JOINTS, "opening")
        )
        schema = replace(
            DenseHeader(**about), channels=channels, digests=digests
        ).schema()

        def write(draft: Path) -> None:
            with pq.ParquetWriter(
                draft, schema, compression="zstd", write_page_checksum=True
            ) as writer:
                for record in records:
                    rows = [
                        _row(record, step) for step in iterate_steps(record, self.hz)
                    ]
                    table = pa.Table.from_pylist(rows, schema=schema)
                    writer.write_table(table, row_group_size=len(rows))

        write_whole(paths[0], write)

    def card(self) -> str:
        """Return what the folder's README says."""
        return _CARD.format(hz=self.hz, columns=describe())


def _shared(header: DenseHeader) -> dict[str, Any]:
    """Return what all files of a data set say about themselves."""
    values = asdict(header)
    return {name: values[name] for name in values if name not in _PER_FILE}


def _row(record: EpisodeRecord, step: DenseStep) -> dict[str, Any]:
    subtask = len(record.subtasks) if step.is_done else step.subtask
    measured = [
        [*joints, opening]
        for joints, opening in zip(
            step.joints.tolist(), step.opening_m.tolist(), strict=True
        )
    ]
    return {
        "key": record.key,
        "task": record.task,
        "split": record.split,
        "index": record.index,
        "step": step.index,
        "time_s": step.time_s,
        "state": [value for row in measured for value in row],
        "velocity": step.joint_velocities.ravel(),
        "objects": entity_poses(step.objects).ravel(),
        "action": step.action.ravel(),
        "reward": step.reward,
        "done": step.is_done,
        "progress": step.progress,
        "subtask": step.subtask,
        **label(record, subtask),
        "high_level": record.high_level,
        "human": record.human,
        "unseen": record.unseen,
    }


_CARD = """# Dense steps of LEMMA Bench

Every episode of a recipe at {hz} steps per second: what was measured, what was
commanded, and which sub-task that belonged to. `lemma render --form dense` made this
by executing the recipe again; `manifest.json` holds the checksum of every file.

Files are Parquet, one row group per episode. Train on the sentences `high_level` and
`human`, never on `unseen`.

{columns}
"""
