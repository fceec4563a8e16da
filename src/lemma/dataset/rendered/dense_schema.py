"""What files of dense steps hold, and how they are read: without MuJoCo or torch.

A Parquet file holds the steps of some episodes, one row group for each episode.
"""

import json
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lemma.core.errors import DatasetError
from lemma.dataset.files import METADATA_KEY
from lemma.dataset.rendered.keyframes.files import damaged
from lemma.dataset.rendered.shards import choose

FORM = "dense"
DENSE_VERSION = "1"
SUFFIX = ".parquet"
FOLDER = "steps"
"""First folder of the files' paths."""


@dataclass(frozen=True, slots=True)
class DenseHeader:
    """What a file says about itself."""

    form: str
    version: str
    versions: dict[str, str]
    """Versions of what made it; see :func:`lemma.dataset.files.versions`."""
    hz: int
    """Steps per simulated second."""
    entities: tuple[str, ...]
    """Names of objects, in the order of the column ``objects``."""
    channels: tuple[str, ...] = ()
    """What the numbers of ``state`` and ``action`` are: ``robot_0/elbow_joint``."""
    digests: tuple[str, ...] = ()
    """Digests of the episodes in the recipe, in the order of the file."""

    @classmethod
    def from_json(cls, path: Path, text: bytes | None) -> "DenseHeader":
        """Read what a file says about itself.

        Raises:
            DatasetError: It is no such file, or of another version.
        """
        data: dict[str, Any] = json.loads(text) if text else {}
        if data.get("form") != FORM:
            raise DatasetError(
                f"{path} holds no dense steps. 'lemma render --form dense' makes them "
                "from a recipe."
            )
        if data["version"] != DENSE_VERSION:
            raise DatasetError(
                f"{path} has version {data['version']} of the dense format, and this "
                f"package reads version {DENSE_VERSION}. Install the version that "
                f"wrote it ({data['versions']['lemma']}), or render it again."
            )
        for name in ("entities", "channels", "digests"):
            data[name] = tuple(data[name])
        return cls(**data)

    def schema(self) -> pa.Schema:
        """Return the columns of a file, with this header as metadata."""
        text = json.dumps(asdict(self), sort_keys=True).encode()
        return pa.schema(
            [
                pa.field(name, kind, nullable=False, metadata={"description": meaning})
                for name, (kind, meaning) in columns(self).items()
            ],
            metadata={METADATA_KEY: text},
        )


def columns(header: DenseHeader) -> dict[str, tuple[pa.DataType, str]]:
    """Return names of columns with type and meaning."""
    text, real = pa.string(), pa.float32()
    size = len(header.channels)
    return {
        "key": (text, "Unique name of the episode."),
        "task": (text, "Task."),
        "split": (text, "Split: train, val, test or free."),
        "index": (pa.int32(), "Number of the episode in its split."),
        "step": (pa.int32(), "Number of the step, from 0."),
        "time_s": (pa.float64(), "Simulated time: step / hz [s]."),
        "state": (
            pa.list_(real, size),
            "Measured: for each robot, six joint angles [rad] and the opening of the "
            "gripper [m]; the header's `channels` names them.",
        ),
        "velocity": (
            pa.list_(real, size // 7 * 6),
            "Measured joint velocities, six for each robot [rad/s].",
        ),
        "objects": (
            pa.list_(real, len(header.entities) * 7),
            "True position [m] and quaternion wxyz of every object of the header's "
            "`entities`; NaN where it is not on the table.",
        ),
        "action": (
            pa.list_(real, size),
            "What was commanded by the next step, as `state`: the joint angles that "
            "the servos were led to, and the opening.",
        ),
        "reward": (real, "1 at the end of an episode that succeeded, else 0."),
        "done": (pa.bool_(), "Whether this is the last step."),
        "progress": (real, "Fraction of the goal that holds."),
        "subtask": (pa.int8(), "Number of the sub-task that comes next; -1: end."),
        "robot": (text, "Its robot; empty at the end."),
        "primitive": (text, "Its primitive; stop at the end."),
        "pick": (text, "Entity that it picks; empty at the end."),
        "place": (text, "Entity where that goes; empty at the end."),
        "sub_instruction": (text, "The sub-task in words."),
        "high_level": (text, "The high-level instruction."),
        "human": (text, "The human-like instruction."),
        "unseen": (text, "The instruction of the unseen split; never train on it."),
    }


def describe() -> str:
    """Return all columns as Markdown, for ``docs/rendered_format.md``."""
    header = DenseHeader(FORM, "", {}, 10, ("",) * 11, ("",) * 14)
    lines = ["| column | type | meaning |", "|---|---|---|"]
    for name, (kind, meaning) in columns(header).items():
        is_list = pa.types.is_fixed_size_list(kind)
        shown = f"{kind.value_type}[{kind.list_size}]" if is_list else kind
        lines.append(f"| `{name}` | `{shown}` | {meaning} |")
    return "\n".join(lines)


def open_steps(path: Path) -> tuple[pq.ParquetFile, DenseHeader]:
    """Open a file of dense steps.

    Raises:
        DatasetError: It is missing, cut short, or not of this format.
    """
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error)) from error
    text = (file.schema_arrow.metadata or {}).get(METADATA_KEY)
    return file, DenseHeader.from_json(path, text)


class DenseDataset:
    """Episodes step by step: ``len(dataset)`` and ``dataset[i]``, a whole episode.

    An episode is a dictionary: numbers as arrays with one row per step, what is the
    same in all steps (key, task, sentences) as one value.
    """

    def __init__(
        self, folder: str | Path, split: str = "train", tasks: Sequence[str] = ()
    ) -> None:
        """Look at what is there; no step is read.

        Args:
            folder: What ``lemma render --form dense`` made.
            split: Name of a split.
            tasks: Names of tasks; all if empty.

        Raises:
            DatasetError: Files are missing, cut short, or of another version.
            UnknownNameError: There is no such split or task.
        """
        names = choose(Path(folder), FORM, FOLDER, split, tasks)
        self._paths = [Path(folder) / name for name in names]
        self.header = open_steps(self._paths[0])[1]
        counts = [open_steps(path)[0].num_row_groups for path in self._paths]
        self._ends: list[int] = list(accumulate(counts))

    def __len__(self) -> int:
        """Return the number of episodes."""
        return self._ends[-1]

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Return an episode.

        Raises:
            IndexError: There are not so many.
            DatasetError: Its file is damaged.
        """
        index = range(len(self))[index]
        place = bisect_right(self._ends, index)
        path = self._paths[place]
        file, _ = open_steps(path)
        try:
            table = file.read_row_group(index - (self._ends[place - 1] if place else 0))
        except (OSError, pa.ArrowException) as error:
            raise DatasetError(damaged(path, error)) from error
        return {name: _values(table, name) for name in table.column_names}


_PER_EPISODE = ("key", "task", "split", "index", "high_level", "human", "unseen")


def _values(table: pa.Table, name: str) -> Any:
    column = table[name].combine_chunks()
    if name in _PER_EPISODE:
        return column[0].as_py()
    if pa.types.is_fixed_size_list(column.type):
        return column.flatten().to_numpy().reshape(len(column), -1)
    return column.to_numpy(zero_copy_only=False)
