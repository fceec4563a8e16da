"""Columns of rendered keyframes: the only place that defines them.

An Arrow file holds the keyframes of some episodes, one record batch for each, so that
any keyframe is found at once. Images are Arrow tensors: any Arrow library reads them.
What a policy needs of every keyframe (map, joints, labels, sentences) and what few need
(camera images) are in files apart, side by side, with the same rows.

Lengths are stored as ``uint16`` in units of 0.1 mm; see :mod:`lemma.scene.raster`.

Reading needs neither MuJoCo nor torch.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from lemma.core.errors import DatasetError
from lemma.core.files import damaged, parse_json
from lemma.dataset.recipe.files import METADATA_KEY
from lemma.dataset.recipe.schema import perturbed_as
from lemma.scene.raster import RASTER, Raster

FORM = "keyframes"
KEYFRAMES_VERSION = "1"
PARTS = ("maps", "cameras")
"""Kinds of files."""
SUFFIX = ".arrow"

EXECUTED = "executed_"
"""Prefix of columns with the executed sub-task of perturbed executions."""


@dataclass(frozen=True, slots=True)
class Header:
    """The record in a file."""

    form: str
    part: str
    """One of :data:`PARTS`."""
    version: str
    versions: dict[str, str]
    """See :func:`lemma.dataset.recipe.files.versions`."""
    renderer: str
    """Software that drew the images; another one may draw other pixels."""
    robots: int
    """Robots, and cameras, of every episode."""
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
    """Number of keyframes of each of them."""

    @property
    def first_rows(self) -> tuple[int, ...]:
        """Rows at which the episodes begin."""
        return tuple(np.cumsum([0, *self.keyframes])[:-1].tolist())

    @property
    def perturbed(self) -> bool:
        """Whether executions were perturbed, so that labels are not what was done."""
        return bool(perturbed_as(self.versions))

    @classmethod
    def from_json(cls, path: Path, text: bytes | None) -> "Header":
        """Read the record of a file.

        Raises:
            DatasetError: It is no such file, or of another version.
        """
        data = parse_json(text, path) if text else {}
        if data.get("form") != FORM:
            raise DatasetError(
                f"{path} holds no rendered keyframes. 'lemma render --form keyframes' "
                "makes them from a recipe."
            )
        versions = data.get("versions")
        if data.get("version") != KEYFRAMES_VERSION:
            by = versions.get("lemma") if isinstance(versions, dict) else None
            raise DatasetError(
                f"{path} has version {data.get('version')} of the keyframe format, and "
                f"this package reads version {KEYFRAMES_VERSION}. Install the version "
                f"that wrote it ({by}), or render it again."
            )
        try:
            return msgspec.convert(data, cls)
        except msgspec.ValidationError as error:
            raise DatasetError(damaged(path, error, "lemma render")) from error

    def schema(self) -> pa.Schema:
        """Return the columns of a file, with this header as metadata."""
        columns = camera_columns(self) if self.part == "cameras" else map_columns(self)
        text = json.dumps(asdict(self), sort_keys=True).encode()
        return pa.schema(
            [pa.field(n, kind, nullable=False) for n, (kind, _) in columns.items()],
            metadata={METADATA_KEY: text},
        )


Columns = dict[str, tuple[pa.DataType, str]]
"""Names of columns with type and meaning."""


def _tensor(scalar: pa.DataType, *shape: int) -> pa.DataType:
    return pa.fixed_shape_tensor(scalar, shape)


def describe() -> str:
    """Return all columns as Markdown, for ``docs/rendered_format.md``."""
    header = Header(FORM, "", "", {}, "", 2, 640, 480, RASTER, ("",) * 11)
    lines = []
    for part, columns in zip(
        PARTS, (map_columns(header), camera_columns(header)), strict=True
    ):
        lines += [f"### `{part}/`", "", "| column | type | meaning |", "|---|---|---|"]
        for name, (kind, meaning) in columns.items():
            lines.append(f"| `{name}` | `{_type_name(kind)}` | {meaning} |")
        lines.append("")
    return "\n".join(lines)


def _type_name(kind: pa.DataType) -> str:
    if isinstance(kind, pa.FixedShapeTensorType):
        return f"{kind.value_type}{list(kind.shape)}"
    return str(kind)


def map_columns(header: Header) -> Columns:
    """Return the columns of files of maps."""
    robots, raster = header.robots, header.raster
    text, real = pa.string(), pa.float64()
    executed = executed_columns() if header.perturbed else {}
    return {
        **executed,
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


def executed_columns() -> Columns:
    """Return the columns that only files of perturbed executions have.

    There the label of a keyframe is what the expert would do, not what was done.
    """
    text = pa.string()
    words = {
        "robot": "Robot that acted next; empty at the end.",
        "primitive": "Primitive that was executed next; stop at the end.",
        "pick": "Entity that it was to pick; empty at the end.",
        "place": "Entity where it was to go; empty at the end.",
    }
    return {
        **{f"{EXECUTED}{name}": (text, meaning) for name, meaning in words.items()},
        "perturbation": (text, "Kind of mistake that was made; none where none was."),
    }


def camera_columns(header: Header) -> Columns:
    """Return the columns of files of camera images."""
    robots, height, width = header.robots, header.height, header.width
    real = pa.float64()
    return {
        "key": (pa.string(), "Unique name of the episode."),
        "keyframe": (pa.int16(), "Number of the keyframe, from 0."),
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


Row = dict[str, Any]
"""One keyframe: values by the names of columns; tensors as NumPy arrays."""
