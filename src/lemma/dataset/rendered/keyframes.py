"""Files of rendered keyframes: columns, writing, and random access.

An Arrow file contains the keyframes of some episodes, one record batch per keyframe,
for random access. Images are Arrow tensors, which any Arrow library reads. Camera
images, which few policies need, are in files separate from the other data (map, joints,
labels, sentences), with the same rows.

Lengths are stored as ``uint16`` in units of 0.1 mm; see :mod:`lemma.scene.raster`.

Reading needs neither MuJoCo nor torch.
"""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from lemma.core.arguments import known
from lemma.core.errors import DatasetError
from lemma.core.files import damaged, parse_json, write_whole
from lemma.dataset.recipe.files import METADATA_KEY, explained
from lemma.dataset.recipe.schema import Columns, markdown_rows, perturbed_as
from lemma.scene.raster import RASTER, Raster

WRITTEN_BY = "lemma render"
"""The command that writes these files."""
FORM = "keyframes"
KEYFRAMES_VERSION = "1"
PARTS = ("maps", "cameras")
"""Kinds of files."""
SUFFIX = ".arrow"

EXECUTED = "executed_"
"""Prefix of columns with the executed sub-task of perturbed executions."""
_EXECUTED_COLUMNS: Columns = {
    f"{EXECUTED}robot": (pa.string(), "Robot that acted next; empty at the end."),
    f"{EXECUTED}primitive": (
        pa.string(),
        "Primitive that was executed next; stop at the end.",
    ),
    f"{EXECUTED}pick": (pa.string(), "Entity that it was to pick; empty at the end."),
    f"{EXECUTED}place": (pa.string(), "Entity where it was to go; empty at the end."),
    "perturbation": (
        pa.string(),
        "Kind of mistake that was made; none where none was.",
    ),
}
"""Additional columns of perturbed executions, with the executed sub-task; the label is
the expert's decision."""
_KEY_POSE_COLUMNS: Columns = {
    "kind": (pa.string(), "What happens at the next key pose, such as pick or put."),
    "key_pose": (
        pa.fixed_shape_tensor(pa.float64(), (4,)),
        "Gripper at the next key pose: x, y, z [m], yaw [rad].",
    ),
}
"""Additional columns of files of key poses; ``robot`` and the sub-task are those of the
key pose."""
KEY_POSES = "key_poses"
"""Entry among the versions that marks files of key poses."""
_PER_FILE = ("part", "robots", "digests", "keyframes")
_CODECS = {
    # Fast for maps, which training reads often; small for camera images, which are
    # most of the data.
    "maps": pa.Codec("lz4"),
    "cameras": pa.Codec("zstd", compression_level=3),
}

Row = dict[str, Any]
"""One keyframe: values by the names of columns; tensors as NumPy arrays."""


@dataclass(frozen=True, slots=True)
class Header:
    """The header of a file: settings, versions and episodes."""

    form: str
    part: str
    """One of :data:`PARTS`."""
    version: str
    versions: dict[str, str]
    """Versions, see :func:`lemma.dataset.recipe.files.versions`."""
    renderer: str
    """Rendering software; another one may give other pixels."""
    robots: int
    """Number of robots and of cameras in every episode."""
    width: int
    """Width of camera images [px]."""
    height: int
    """Height of camera images [px]."""
    raster: Raster
    entities: tuple[str, ...]
    """Names of objects, in the order of the column ``objects``."""
    digests: tuple[str, ...] = ()
    """Digests of the episodes in the recipe, in the order of the file."""
    keyframes: tuple[int, ...] = ()
    """Number of keyframes of each of these episodes."""

    @property
    def perturbed(self) -> bool:
        """Whether executions were perturbed, so labels differ from executions."""
        return bool(perturbed_as(self.versions))

    @property
    def key_poses(self) -> bool:
        """Whether rows are key poses, without camera images."""
        return KEY_POSES in self.versions

    @classmethod
    def from_json(cls, path: Path, text: bytes | None) -> "Header":
        """Read the header of a file.

        Args:
            path: The file, for error messages.
            text: The header's JSON; None if the file has none.

        Raises:
            DatasetError: The file has no rendered keyframes, or another version.
        """
        data = parse_json(text, path) if text else {}
        if data.get("form") != FORM:
            raise DatasetError(
                f"{path} has no rendered keyframes. 'lemma render --form keyframes' "
                "makes them from a recipe."
            )
        versions = data.get("versions")
        if data.get("version") != KEYFRAMES_VERSION:
            by = versions.get("lemma") if isinstance(versions, dict) else None
            raise DatasetError(
                f"{path} has version {data.get('version')} of the keyframe format, but "
                f"this package reads version {KEYFRAMES_VERSION}. Install the version "
                f"that wrote it ({by}), or render it again."
            )
        try:
            return msgspec.convert(data, cls)
        except msgspec.ValidationError as error:
            raise DatasetError(damaged(path, error, WRITTEN_BY)) from error

    def about(self) -> dict[str, Any]:
        """Return the settings and versions that determine the bytes of all files."""
        return {n: value for n, value in asdict(self).items() if n not in _PER_FILE}

    def schema(self) -> pa.Schema:
        """Return the columns of a file, with this header as metadata."""
        columns = camera_columns(self) if self.part == "cameras" else map_columns(self)
        text = json.dumps(asdict(self), sort_keys=True).encode()
        return pa.schema(
            [pa.field(n, kind, nullable=False) for n, (kind, _) in columns.items()],
            metadata={METADATA_KEY: text},
        )


def _tensor(scalar: pa.DataType, *shape: int) -> pa.DataType:
    return pa.fixed_shape_tensor(scalar, shape)


def describe() -> str:
    """Return all columns as Markdown, for cards and documentation."""
    header = Header(FORM, "", "", {}, "", 2, 640, 480, RASTER, ("",) * 11)
    lines = []
    for part, columns in zip(PARTS, (map_columns, camera_columns), strict=True):
        lines += [f"### `{part}/`", "", *markdown_rows(columns(header)), ""]
    return "\n".join(lines)


def map_columns(header: Header) -> Columns:
    """Return the columns of files of maps."""
    robots, raster = header.robots, header.raster
    text, real = pa.string(), pa.float64()
    return {
        **(_EXECUTED_COLUMNS if header.perturbed else {}),
        **(_KEY_POSE_COLUMNS if header.key_poses else {}),
        "key": (text, "Unique name of the episode."),
        "task": (text, "Task."),
        "split": (text, "Split: train, val, test or free."),
        "index": (pa.int32(), "Number of the episode in its split."),
        "keyframe": (pa.int16(), "Number of the keyframe, from 0."),
        "keyframes": (pa.int16(), "Number of keyframes of the episode."),
        "time_s": (real, "Simulated time [s]."),
        "team": (text, "Arm types from small to large, such as ur5+ur10."),
        "arms": (text, "Arm types in the order of the robots, such as ur10+ur5."),
        "bases": (_tensor(real, robots, 3), "Bases: x, y [m], yaw [rad]."),
        "high_level": (text, "The high-level instruction."),
        "human": (text, "The human-like instruction."),
        "unseen": (text, "The instruction of the unseen split; never train on it."),
        "goal": (text, "The goal as JSON: [[top, bottom], ...]."),
        "robot": (text, "Robot of the next sub-task; empty at the end."),
        "primitive": (text, "Primitive of the next sub-task; stop at the end."),
        "pick": (text, "Entity that is picked; empty at the end."),
        "place": (text, "Entity where it goes; empty at the end."),
        "pick_pose": (_tensor(real, 3), "x, y [m], yaw [rad]; NaN at the end."),
        "place_pose": (_tensor(real, 3), "x, y [m], yaw [rad]; NaN at the end."),
        "sub_instruction": (text, "The next sub-task in words."),
        "outcome": (text, "How the next sub-task went; stopped at the end."),
        "joints": (_tensor(real, robots, 6), "Measured joint angles [rad]."),
        "opening_m": (_tensor(real, robots), "Measured gripper openings [m]."),
        "objects": (
            _tensor(real, len(header.entities), 7),
            "True position [m] and quaternion wxyz of every object of the header's "
            "`entities`; NaN where it is not on the table.",
        ),
        "instance": (text, "The whole instance as canonical JSON."),
        "map_rgb": (_tensor(pa.uint8(), raster.rows, raster.columns, 3), "Map: color."),
        "map_height": (
            _tensor(pa.uint16(), raster.rows, raster.columns),
            "Map: 1 + height above `floor_m` [0.1 mm]; 0 where no camera sees.",
        ),
    }


def camera_columns(header: Header) -> Columns:
    """Return the columns of files of camera images."""
    robots, height, width = header.robots, header.height, header.width
    real = pa.float64()
    named: Columns = {
        "key": (pa.string(), "Unique name of the episode."),
        "keyframe": (pa.int16(), "Number of the keyframe, from 0."),
    }
    if header.key_poses:
        return named
    return {
        **named,
        "intrinsics": (_tensor(real, robots, 3, 3), "Matrix K of each camera [px]."),
        "world_from_camera": (
            _tensor(real, robots, 4, 4),
            "Pose of each camera: x right, y down, z forward [m].",
        ),
        "rgb": (_tensor(pa.uint8(), robots, height, width, 3), "Color."),
        "depth": (
            _tensor(pa.uint16(), robots, height, width),
            "Distance along the camera's z axis [0.1 mm]; 0 where nothing is.",
        ),
    }


def write_keyframes(files: Sequence[tuple[Path, Header]], rows: Iterable[Row]) -> None:
    """Write files with the same rows, each completely or not at all.

    Only one row is in memory at a time.

    Args:
        files: The files and their headers.
        rows: The keyframes, with the columns of all files, in the order of the headers'
            episodes.

    Raises:
        DatasetError: A file cannot be written.
    """

    def open_rest(writers: list[pa.ipc.RecordBatchFileWriter]) -> None:
        if len(writers) == len(files):
            for row in rows:
                for writer, schema in zip(writers, schemas, strict=True):
                    writer.write_batch(_batch(row, schema))
            return
        path, header = files[len(writers)]

        def write(draft: Path) -> None:
            options = pa.ipc.IpcWriteOptions(
                compression=_CODECS[header.part],
                # Many processes write at the same time, so threads are of no use.
                use_threads=False,
            )
            with (
                pa.OSFile(str(draft), "wb") as sink,
                pa.ipc.new_file(sink, header.schema(), options=options) as writer,
            ):
                open_rest([*writers, writer])

        write_whole(path, write)

    schemas = [header.schema() for _, header in files]
    open_rest([])


def _batch(row: Row, schema: pa.Schema) -> pa.RecordBatch:
    arrays = [_array(row[field.name], field.type) for field in schema]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _array(value: Any, kind: pa.DataType) -> pa.Array:
    """Return an Arrow array of one element."""
    if not isinstance(kind, pa.FixedShapeTensorType):
        return pa.array([value], kind)
    flat = np.ascontiguousarray(value, _dtype(kind.value_type)).reshape(-1)
    storage = pa.FixedSizeListArray.from_arrays(pa.array(flat), math.prod(kind.shape))
    return pa.ExtensionArray.from_storage(kind, storage)


@cache
def _dtype(scalar: pa.DataType) -> np.dtype[Any]:
    """Return the NumPy type of an Arrow type; pyarrow's own method may need pandas."""
    dtype: np.dtype[Any] = pa.array([], scalar).to_numpy().dtype
    return dtype


def mapped(path: Path) -> pa.NativeFile:
    """Return a memory-mapped file, which several threads may read.

    Raises:
        DatasetError: The file is missing or empty.
    """
    with explained(path, WRITTEN_BY):
        return pa.memory_map(str(path))


class KeyframeFile:
    """An open file with random access to its rows."""

    def __init__(
        self,
        path: Path,
        columns: Sequence[str] | None = None,
        source: pa.NativeFile | None = None,
    ) -> None:
        """Open a file, and read only its table of contents.

        Args:
            path: The file.
            columns: Names of columns to read; all if None.
            source: The file from :func:`mapped`, which several objects may share; None
                to open it here.

        Raises:
            DatasetError: The file is missing, truncated, or not of this format.
            UnknownNameError: The file has no such column.
        """
        self.path = path
        self._source = mapped(path) if source is None else source
        reader = self._open(pa.ipc.IpcReadOptions(use_threads=False))
        self.header = Header.from_json(
            path, (reader.schema.metadata or {}).get(METADATA_KEY)
        )
        names = reader.schema.names
        for name in columns or ():
            known(f"column of {path.name}", name, names)
        if columns is not None:
            wanted = [names.index(name) for name in names if name in columns]
            reader = self._open(
                pa.ipc.IpcReadOptions(use_threads=False, included_fields=wanted)
            )
        self._reader = reader

    def _open(self, options: pa.ipc.IpcReadOptions) -> pa.ipc.RecordBatchFileReader:
        with explained(self.path, WRITTEN_BY):
            return pa.ipc.open_file(self._source, options=options)

    @cached_property
    def _kinds(self) -> list[tuple[str, pa.DataType]]:
        # The schema of a batch has only the chosen columns.
        return [(f.name, f.type) for f in self._reader.get_batch(0).schema]

    def __len__(self) -> int:
        """Return the number of keyframes."""
        count: int = self._reader.num_record_batches
        return count

    def __getitem__(self, row: int) -> Row:
        """Return a keyframe; its arrays are copies, which the caller may change.

        Raises:
            DatasetError: The file is damaged.
        """
        with explained(self.path, WRITTEN_BY):
            batch = self._reader.get_batch(row)
            return {
                name: _value(batch.column(i), kind)
                for i, (name, kind) in enumerate(self._kinds)
            }


def _value(column: pa.Array, kind: pa.DataType) -> Any:
    """Return the single value of a column; arrays are writable."""
    if not isinstance(kind, pa.FixedShapeTensorType):
        return column[0].as_py()
    buffer = column.storage.values.buffers()[1]
    array = np.frombuffer(buffer, _dtype(kind.value_type), math.prod(kind.shape))
    array = array.reshape(kind.shape)
    # Uncompressed buffers are the file itself: copy them.
    return array if array.flags.writeable else array.copy()
