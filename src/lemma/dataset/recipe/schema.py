"""Columns of a recipe: the only place that defines them.

A recipe holds no pictures. It holds the instance, the executed sub-tasks, the full
integration state of the physics at every keyframe, from which anything can be rendered,
and a hash of each state, which a replay is compared with.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lemma.core.files import parse_json
from lemma.core.poses import FloatArray, Pose2
from lemma.tasks.subtask import GroundedSubTask, Primitive

FORMAT_VERSION = "1"
PERTURB_KEYS = ("perturb", "perturb_seed")
"""Entries of a record that only recipes of perturbed executions have."""

_TEXT = {
    "key": "Unique name: benchmark version, task, split, index.",
    "task": "Task.",
    "split": "Split: train, val, test or free.",
    "index": "Number in the split.",
    "team": "Arm types from small to large, such as ur5+ur10.",
    "distractors": "Objects that the goal does not need.",
    "high_level": "The high-level instruction.",
    "human": "The human-like instruction.",
    "unseen": "The instruction of the unseen split; never train on it.",
    "instance": "The whole instance as canonical JSON.",
    "instance_sha256": "SHA-256 of that JSON.",
    "subtasks": "What was done, in order.",
    "keyframe_time_s": "Simulated time of every keyframe [s].",
    "keyframe_state": "Integration state of MuJoCo, little-endian float64.",
    "keyframe_sha256": "SHA-256 of every state.",
    "success": "Whether the goal holds at the end.",
    "progress": "Fraction of the goal that holds at the end.",
    "failure": "Why it failed; null where it did not.",
    "elapsed_s": "Simulated time that it took [s].",
    "idle_s": "How long each robot waited [s], in the order of the robots.",
}
"""Meaning of every column, for the documentation and for the file itself."""

_PERTURBED_TEXT = {
    "expert": "At each keyframe what the expert would do; null where it knows nothing.",
    "perturbation": "What was done to each sub-task before it was executed, or none.",
}
"""The columns that recipes of perturbed executions have beside all others."""

_SUBTASK = pa.struct(
    [
        pa.field("robot", pa.string(), nullable=False),
        pa.field("primitive", pa.string(), nullable=False),
        pa.field("pick", pa.string(), nullable=False),
        pa.field("place", pa.string(), nullable=False),
        pa.field("instruction", pa.string(), nullable=False),
        pa.field("pick_pose", pa.list_(pa.float64(), 3), nullable=False),
        pa.field("place_pose", pa.list_(pa.float64(), 3), nullable=False),
        pa.field("outcome", pa.string(), nullable=False),
        pa.field("start_s", pa.float64(), nullable=False),
        pa.field("duration_s", pa.float64(), nullable=False),
    ]
)

_TYPES: dict[str, pa.DataType] = {
    "index": pa.int32(),
    "distractors": pa.int8(),
    "subtasks": pa.list_(_SUBTASK),
    "keyframe_time_s": pa.list_(pa.float64()),
    "keyframe_state": pa.list_(pa.binary()),
    "keyframe_sha256": pa.list_(pa.string()),
    "success": pa.bool_(),
    "progress": pa.float64(),
    "elapsed_s": pa.float64(),
    "idle_s": pa.list_(pa.float64()),
}

SCHEMA = pa.schema(
    [
        pa.field(
            name,
            _TYPES.get(name, pa.string()),
            nullable=name == "failure",
            metadata={"description": text},
        )
        for name, text in _TEXT.items()
    ]
)

_EXPERT = pa.struct(
    [
        pa.field("robot", pa.string(), nullable=False),
        pa.field("primitive", pa.string(), nullable=False),
        pa.field("pick", pa.string(), nullable=False),
        pa.field("place", pa.string(), nullable=False),
        pa.field("instruction", pa.string(), nullable=False),
        # Of any length: not every pyarrow reads Parquet files in which a list of fixed
        # length is null.
        pa.field("pick_pose", pa.list_(pa.float64())),
        pa.field("place_pose", pa.list_(pa.float64())),
    ]
)

PERTURBED_SCHEMA = pa.schema(
    [
        *SCHEMA,
        *(
            pa.field(
                name,
                kind,
                nullable=False,
                metadata={"description": _PERTURBED_TEXT[name]},
            )
            for name, kind in (
                ("expert", pa.list_(_EXPERT)),
                ("perturbation", pa.list_(pa.string())),
            )
        ),
    ]
)
"""Columns of recipes of perturbed executions; see :class:`PerturbedRecord`."""


@dataclass(frozen=True, slots=True)
class SubTaskRecord:
    """One executed sub-task."""

    robot: str
    primitive: str
    pick: str
    place: str
    instruction: str
    """The sub-task in words."""
    pick_pose: tuple[float, float, float]
    """Gripper where it closed: x, y [m], yaw [rad]."""
    place_pose: tuple[float, float, float]
    """Gripper where the motion ended: x, y [m], yaw [rad]."""
    outcome: str
    start_s: float
    duration_s: float

    @property
    def grounded(self) -> GroundedSubTask:
        """The executed sub-task, ready to be executed again."""
        who = self.robot, Primitive(self.primitive)
        return GroundedSubTask(*who, Pose2(*self.pick_pose), Pose2(*self.place_pose))


@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """One episode of a recipe; plain data."""

    key: str
    task: str
    split: str
    index: int
    team: str
    distractors: int
    high_level: str
    human: str
    unseen: str
    instance: str
    instance_sha256: str
    subtasks: tuple[SubTaskRecord, ...]
    keyframe_time_s: tuple[float, ...]
    keyframe_state: tuple[bytes, ...] = field(repr=False)
    keyframe_sha256: tuple[str, ...] = field(repr=False)
    success: bool
    progress: float
    failure: str | None
    elapsed_s: float
    idle_s: tuple[float, ...]

    @property
    def keyframes(self) -> int:
        """Number of keyframes: one before each sub-task, and the end."""
        return len(self.keyframe_time_s)

    def state(self, keyframe: int) -> FloatArray:
        """Return the integration state at a keyframe."""
        return np.frombuffer(self.keyframe_state[keyframe], dtype="<f8")

    def instance_data(self) -> dict[str, Any]:
        """Return the instance as plain data; ``Instance.from_dict`` reads it.

        Raises:
            DatasetError: It is no JSON object.
        """
        return parse_json(self.instance, Path(f"the instance of {self.key}"))

    def digest(self) -> str:
        """Return the SHA-256 of everything in the record."""
        summary = json.dumps(
            [
                self.instance,
                [
                    [getattr(row, name) for name in SubTaskRecord.__slots__]
                    for row in self.subtasks
                ],
                self.keyframe_time_s,
                self.keyframe_sha256,
                [self.success, self.progress, self.failure],
                [self.elapsed_s, self.idle_s],
            ],
            separators=(",", ":"),
        )
        return hashlib.sha256(summary.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class ExpertRecord:
    """The expert's decision at a keyframe."""

    robot: str
    """Empty for ``stop``, as are what to pick and where to place."""
    primitive: str
    pick: str
    place: str
    instruction: str
    """The sub-task in words."""
    pick_pose: tuple[float, float, float] | None
    """Gripper where it closes: x, y [m], yaw [rad]; None for ``stop``."""
    place_pose: tuple[float, float, float] | None
    """Gripper where the motion ends: x, y [m], yaw [rad]; None for ``stop``."""


@dataclass(frozen=True, slots=True)
class PerturbedRecord(EpisodeRecord):
    """One episode whose sub-tasks were perturbed now and then; plain data.

    ``subtasks`` are what was executed, so that it is replayed like any other.
    """

    expert: tuple[ExpertRecord | None, ...]
    """The expert's decision at each keyframe; None where it has no plan, where its own
    sub-task failed, and behind the last one if the time was up."""
    perturbation: tuple[str, ...]
    """Perturbation of each sub-task; see :data:`lemma.expert.disturbances.KINDS`."""

    @property
    def labelled(self) -> int:
        """Number of keyframes before the first without a label."""
        known = [*self.expert, None]
        return known.index(None)

    def digest(self) -> str:
        """Return the SHA-256 of everything in the record."""
        rows = [
            row and [getattr(row, name) for name in ExpertRecord.__slots__]
            for row in self.expert
        ]
        # super() does not know a class with slots.
        summary = json.dumps(
            [EpisodeRecord.digest(self), rows, self.perturbation],
            separators=(",", ":"),
        )
        return hashlib.sha256(summary.encode()).hexdigest()


def perturbed_as(about: dict[str, str]) -> dict[str, str]:
    """Return the entries of a record about a perturbation; empty if none."""
    return {name: about[name] for name in PERTURB_KEYS if name in about}


def executions(about: dict[str, str]) -> str:
    """Return in words whether executions were perturbed."""
    if not perturbed_as(about):
        return "demonstrations"
    return (
        f"executions perturbed with {' and seed '.join(perturbed_as(about).values())}"
    )


def to_table(records: Sequence[EpisodeRecord]) -> pa.Table:
    """Return records as an Arrow table of :data:`SCHEMA`, or of the perturbed one."""
    perturbed = any(isinstance(record, PerturbedRecord) for record in records)
    schema = PERTURBED_SCHEMA if perturbed else SCHEMA
    columns: dict[str, list[Any]] = {
        name: [getattr(record, name) for record in records] for name in schema.names
    }
    parts = {"subtasks": SubTaskRecord.__slots__, "expert": ExpertRecord.__slots__}
    for column, names in parts.items():
        if column in columns:
            columns[column] = [
                [row and {name: getattr(row, name) for name in names} for row in rows]
                for rows in columns[column]
            ]
    return pa.table(columns, schema=schema)


def from_table(table: pa.Table) -> list[EpisodeRecord]:
    """Return the records of a table: the inverse of :func:`to_table`."""
    return [_record(row) for row in table.to_pylist()]


def _record(row: dict[str, Any]) -> EpisodeRecord:
    listed = {name: tuple(v) for name, v in row.items() if isinstance(v, list)}
    subtasks = tuple(SubTaskRecord(**_with_poses(sub)) for sub in row["subtasks"])
    values = {**row, **listed, "subtasks": subtasks}
    if "expert" not in row:
        return EpisodeRecord(**values)
    expert = tuple(
        None if known is None else ExpertRecord(**_with_poses(known))
        for known in row["expert"]
    )
    return PerturbedRecord(**{**values, "expert": expert})


def _with_poses(row: dict[str, Any]) -> dict[str, Any]:
    poses = {name: row[name] for name in ("pick_pose", "place_pose")}
    return {**row, **{name: pose and tuple(pose) for name, pose in poses.items()}}


def describe(*, perturbed: bool = False) -> str:
    """Return the schema as a Markdown table, for ``docs/dataset_format.md``.

    Args:
        perturbed: Whether to describe instead the columns that only recipes of
            perturbed executions have.
    """
    texts = _PERTURBED_TEXT if perturbed else _TEXT
    lines = ["| column | type | meaning |", "|---|---|---|"]
    for name, text in texts.items():
        kind = PERTURBED_SCHEMA.field(name).type
        lines.append(f"| `{name}` | `{kind}` | {text} |")
    return "\n".join(lines)
