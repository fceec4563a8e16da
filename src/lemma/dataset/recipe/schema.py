"""Definition of the columns of a recipe.

A recipe contains no images. It contains the instance, the executed sub-tasks, MuJoCo's
full integration state at every keyframe, from which images can be rendered, and a hash
of each state for the comparison with a replay.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from lemma.core.files import parse_json
from lemma.core.poses import FloatArray, Pose2
from lemma.tasks.subtask import GroundedSubTask, Primitive

FORMAT_VERSION = "1"
PERTURB_KEYS = ("perturb", "perturb_seed")
"""Entries of a file's record that only recipes of perturbed executions have."""

_WORDS, _REAL = pa.string(), pa.float64()
_NAMES = ("robot", "primitive", "pick", "place", "instruction")


def _struct(**kinds: pa.DataType) -> pa.StructType:
    return pa.struct([pa.field(n, kind, nullable=False) for n, kind in kinds.items()])


_SUBTASK = _struct(
    **dict.fromkeys(_NAMES, _WORDS),
    **dict.fromkeys(("pick_pose", "place_pose"), pa.list_(_REAL, 3)),
    outcome=_WORDS,
    start_s=_REAL,
    duration_s=_REAL,
)
# Lists of variable length for poses: some versions of pyarrow cannot read Parquet files
# with a null list of fixed length.
_EXPERT = pa.struct(
    [
        *_struct(**dict.fromkeys(_NAMES, _WORDS)),
        *(pa.field(name, pa.list_(_REAL)) for name in ("pick_pose", "place_pose")),
    ]
)

Columns = dict[str, tuple[pa.DataType, str]]
"""Names of columns with type and meaning."""

_COLUMNS: Columns = {
    "key": (_WORDS, "Unique name: benchmark version, task, split, index."),
    "task": (_WORDS, "Task."),
    "split": (_WORDS, "Split: train, val, test or free."),
    "index": (pa.int32(), "Number in the split."),
    "team": (_WORDS, "Arm types from small to large, such as ur5+ur10."),
    "distractors": (pa.int8(), "Objects that the goal does not need."),
    "high_level": (_WORDS, "The high-level instruction."),
    "human": (_WORDS, "The human-like instruction."),
    "unseen": (_WORDS, "The instruction of the unseen split; never train on it."),
    "instance": (_WORDS, "The whole instance as canonical JSON."),
    "instance_sha256": (_WORDS, "SHA-256 of that JSON."),
    "subtasks": (pa.list_(_SUBTASK), "What was done, in order."),
    "keyframe_time_s": (pa.list_(_REAL), "Simulated time of every keyframe [s]."),
    "keyframe_state": (
        pa.list_(pa.binary()),
        "Integration state of MuJoCo, little-endian float64.",
    ),
    "keyframe_sha256": (pa.list_(_WORDS), "SHA-256 of every state."),
    "success": (pa.bool_(), "Whether the goal holds at the end."),
    "progress": (_REAL, "Fraction of the goal that holds at the end."),
    "failure": (_WORDS, "Why it failed; null where it did not."),
    "elapsed_s": (_REAL, "Simulated time that it took [s]."),
    "idle_s": (
        pa.list_(_REAL),
        "How long each robot waited [s], in the order of the robots.",
    ),
}

_PERTURBED_COLUMNS: Columns = {
    "expert": (
        pa.list_(_EXPERT),
        "At each keyframe what the expert would do; null where it knows nothing.",
    ),
    "perturbation": (
        pa.list_(_WORDS),
        "What was done to each sub-task before it was executed, or none.",
    ),
}
"""Additional columns of recipes of perturbed executions."""


def _schema(columns: Columns) -> pa.Schema:
    return pa.schema(
        [
            pa.field(
                name,
                kind,
                nullable=name == "failure",
                metadata={"description": text},
            )
            for name, (kind, text) in columns.items()
        ]
    )


SCHEMA = _schema(_COLUMNS)
PERTURBED_SCHEMA = _schema({**_COLUMNS, **_PERTURBED_COLUMNS})
"""Columns of recipes of perturbed executions; see :class:`PerturbedRecord`."""


@dataclass(frozen=True, slots=True)
class ExpertRecord:
    """The expert's decision at a keyframe."""

    robot: str
    """Name of the robot; ``robot``, ``pick`` and ``place`` are empty for ``stop``."""
    primitive: str
    pick: str
    place: str
    instruction: str
    """The sub-instruction."""
    pick_pose: tuple[float, float, float] | None
    """Gripper at the grasp, in the world's frame: x, y [m], yaw [rad]; None for
    ``stop``."""
    place_pose: tuple[float, float, float] | None
    """Gripper at the end of the motion, in the world's frame: x, y [m], yaw [rad]; None
    for ``stop``."""


@dataclass(frozen=True, slots=True)
class SubTaskRecord(ExpertRecord):
    """One executed sub-task."""

    pick_pose: tuple[float, float, float]
    """Gripper at the grasp, in the world's frame: x, y [m], yaw [rad]."""
    place_pose: tuple[float, float, float]
    """Gripper at the end of the motion, in the world's frame: x, y [m], yaw [rad]."""
    outcome: str
    start_s: float
    duration_s: float

    @property
    def grounded(self) -> GroundedSubTask:
        """The sub-task with poses, for another execution."""
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
        """Number of keyframes: one before each sub-task, and one at the end."""
        return len(self.keyframe_time_s)

    def state(self, keyframe: int) -> FloatArray:
        """Return MuJoCo's integration state at a keyframe, a vector of float64."""
        return np.frombuffer(self.keyframe_state[keyframe], dtype="<f8")

    def instance_data(self) -> dict[str, Any]:
        """Return the instance as plain data; ``Instance.from_dict`` reads it.

        Raises:
            DatasetError: The text is not a JSON object.
        """
        return parse_json(self.instance, Path(f"the instance of {self.key}"))

    def digest(self) -> str:
        """Return the SHA-256 of everything in the record."""
        summary = json.dumps(
            [
                self.instance,
                [astuple(row) for row in self.subtasks],
                self.keyframe_time_s,
                self.keyframe_sha256,
                [self.success, self.progress, self.failure],
                [self.elapsed_s, self.idle_s],
            ],
            separators=(",", ":"),
        )
        return hashlib.sha256(summary.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class PerturbedRecord(EpisodeRecord):
    """One episode with some perturbed sub-tasks; plain data.

    ``subtasks`` are the executed ones, so it is replayed like any other episode.
    """

    expert: tuple[ExpertRecord | None, ...]
    """The expert's decision at each keyframe. It is None where the expert has no plan
    or its own sub-task failed, and at the last keyframe if the time was up."""
    perturbation: tuple[str, ...]
    """Perturbation of each sub-task; see :data:`lemma.expert.disturbances.KINDS`."""

    @property
    def labelled(self) -> int:
        """Number of keyframes before the first without a label."""
        known = [*self.expert, None]
        return known.index(None)

    def digest(self) -> str:
        """Return the SHA-256 of everything in the record."""
        rows = [row and astuple(row) for row in self.expert]
        # Not super(): slots create another class.
        summary = json.dumps(
            [EpisodeRecord.digest(self), rows, self.perturbation],
            separators=(",", ":"),
        )
        return hashlib.sha256(summary.encode()).hexdigest()


def perturbed_as(about: dict[str, str]) -> dict[str, str]:
    """Return a file's entries about a perturbation; empty without one."""
    return {name: about[name] for name in PERTURB_KEYS if name in about}


def executions(about: dict[str, str]) -> str:
    """Return a text about whether executions were perturbed."""
    if not perturbed_as(about):
        return "demonstrations"
    return (
        f"executions perturbed with {' and seed '.join(perturbed_as(about).values())}"
    )


def to_table(records: Sequence[EpisodeRecord]) -> pa.Table:
    """Return records as an Arrow table of :data:`SCHEMA`, or of the perturbed one."""
    perturbed = any(isinstance(record, PerturbedRecord) for record in records)
    rows = [msgspec.to_builtins(record, builtin_types=(bytes,)) for record in records]
    return pa.Table.from_pylist(rows, PERTURBED_SCHEMA if perturbed else SCHEMA)


def from_table(table: pa.Table) -> list[EpisodeRecord]:
    """Return the records of a table: the inverse of :func:`to_table`."""
    kind = PerturbedRecord if "expert" in table.column_names else EpisodeRecord
    return [msgspec.convert(row, kind) for row in table.to_pylist()]


def describe(*, perturbed: bool = False) -> str:
    """Return the schema as a Markdown table, for cards and documentation.

    Args:
        perturbed: Whether to describe only the additional columns of recipes of
            perturbed executions.
    """
    return "\n".join(markdown_rows(_PERTURBED_COLUMNS if perturbed else _COLUMNS))


def markdown_rows(columns: Columns) -> list[str]:
    """Return the lines of a Markdown table of columns."""
    rows = (
        f"| `{name}` | `{_type_name(kind)}` | {text} |"
        for name, (kind, text) in columns.items()
    )
    return ["| column | type | meaning |", "|---|---|---|", *rows]


def _type_name(kind: pa.DataType) -> str:
    if isinstance(kind, pa.FixedShapeTensorType):
        return f"{kind.value_type}{list(kind.shape)}"
    return str(kind)
