"""Files of rendered keyframes: writing them, and reading any keyframe at once.

See :mod:`lemma.dataset.rendered.keyframes.schema` for what they hold.
Neither MuJoCo nor torch is needed.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.core.files import damaged, write_whole
from lemma.dataset.recipe.files import METADATA_KEY
from lemma.dataset.rendered.keyframes.schema import Header, Row

_CODECS = {
    # Maps are read thousands of times a second, camera images are most of the bytes.
    "maps": pa.Codec("lz4"),
    "cameras": pa.Codec("zstd", compression_level=3),
}


def write_keyframes(files: Sequence[tuple[Path, Header]], rows: Iterable[Row]) -> None:
    """Write files side by side, each whole or not at all.

    Only one row is in memory at a time.

    Args:
        files: The files, and what they say about themselves.
        rows: The keyframes, with the columns of all the files, in the order of the
            headers' episodes.

    Raises:
        DatasetError: They cannot be written.
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
                # Many processes write at the same time.
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


def _dtype(scalar: pa.DataType) -> np.dtype[Any]:
    """Return NumPy's name for a type of numbers; pyarrow's own way may need pandas."""
    dtype: np.dtype[Any] = pa.array([], scalar).to_numpy().dtype
    return dtype


def mapped(path: Path) -> pa.NativeFile:
    """Return a file in memory, which several threads may read.

    Raises:
        DatasetError: It is missing, or empty.
    """
    try:
        return pa.memory_map(str(path))
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error, "lemma render")) from error


class KeyframeFile:
    """An open file: any row at once."""

    def __init__(
        self,
        path: Path,
        columns: Sequence[str] | None = None,
        source: pa.NativeFile | None = None,
    ) -> None:
        """Open a file; nothing of it is read but its table of contents.

        Args:
            path: The file.
            columns: Names of columns to read; all if None.
            source: The file as :func:`mapped` returned it, maybe to others too.

        Raises:
            DatasetError: It is missing, cut short, or not of this format.
            UnknownNameError: It has no such column.
        """
        self.path = path
        self._source = mapped(path) if source is None else source
        reader = self._open(pa.ipc.IpcReadOptions(use_threads=False))
        self.header = Header.from_json(
            path, (reader.schema.metadata or {}).get(METADATA_KEY)
        )
        names = reader.schema.names
        for name in columns or ():
            if name not in names:
                raise UnknownNameError(f"column of {path.name}", name, names)
        if columns is not None:
            wanted = [names.index(name) for name in names if name in columns]
            reader = self._open(
                pa.ipc.IpcReadOptions(use_threads=False, included_fields=wanted)
            )
        self._reader = reader

    def _open(self, options: pa.ipc.IpcReadOptions) -> pa.ipc.RecordBatchFileReader:
        try:
            return pa.ipc.open_file(self._source, options=options)
        except (OSError, pa.ArrowException) as error:
            raise DatasetError(damaged(self.path, error, "lemma render")) from error

    @cached_property
    def _decoders(self) -> list[tuple[str, "_Tensor | None"]]:
        schema = self._reader.get_batch(0).schema
        return [(f.name, _Tensor.of(f.type)) for f in schema]

    def __len__(self) -> int:
        """Return the number of keyframes."""
        count: int = self._reader.num_record_batches
        return count

    def __getitem__(self, row: int) -> Row:
        """Return a keyframe; arrays belong to the caller, who may change them.

        Raises:
            DatasetError: The file is damaged.
        """
        try:
            batch = self._reader.get_batch(row)
            return {
                name: batch.column(i)[0].as_py()
                if tensor is None
                else tensor.decode(batch.column(i))
                for i, (name, tensor) in enumerate(self._decoders)
            }
        except (OSError, pa.ArrowException) as error:
            raise DatasetError(damaged(self.path, error, "lemma render")) from error


@dataclass(frozen=True, slots=True)
class _Tensor:
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    @classmethod
    def of(cls, kind: pa.DataType) -> "_Tensor | None":
        if not isinstance(kind, pa.FixedShapeTensorType):
            return None
        return cls(_dtype(kind.value_type), tuple(kind.shape))

    def decode(self, column: pa.ExtensionArray) -> NDArray[Any]:
        """Return an array that can be written to, without copying if possible."""
        buffer = column.storage.values.buffers()[1]
        array = np.frombuffer(buffer, self.dtype, math.prod(self.shape))
        array = array.reshape(self.shape)
        # Uncompressed buffers are the file itself: copy them.
        return array if array.flags.writeable else array.copy()
