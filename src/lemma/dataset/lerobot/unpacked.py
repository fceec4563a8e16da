"""A LeRobotDataset whose pictures are decoded once, for training.

lerobot opens a video for every picture that it reads and looks a row up for every
number, which takes 25 ms of a core a sample; a GPU learns from thousands a second.
Unpacked, pictures lie in files that all trainings of a machine map into memory.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lemma.core.errors import DatasetError
from lemma.core.files import only_writer, write_whole
from lemma.core.workers.pool import Engine
from lemma.dataset.lerobot.export import INFO

_SUFFIX = ".npy"
_TAKEN = "_reads_unpacked"
_VIDEOS = "videos"


def unpack(
    root: Path,
    folder: Path,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> int:
    """Decode all videos of a data set; those that are there already are kept.

    Args:
        root: Folder of the data set.
        folder: Where to put the pictures: width × height × 3 bytes each.
        engine: Where to work.
        advance: Told how many videos were there, and then of each that is done.

    Returns:
        How many videos there are.

    Raises:
        DatasetError: There is no data set, or the disk is full.
    """
    if not (root / INFO).is_file():
        raise DatasetError(f"There is no LeRobotDataset in {root}.")
    videos = sorted((root / _VIDEOS).rglob("*.mp4"))
    with only_writer(folder):
        jobs = [
            (video, target)
            for video in videos
            if not (target := _unpacked(root, folder, video)).exists()
        ]
        advance(len(videos) - len(jobs))
        for _ in engine.run(decode, jobs):
            advance(1)
    return len(videos)


def decode(video: Path, target: Path) -> None:
    """Write all pictures of a video as an array (frames, 3, height, width), uint8."""
    with av.open(str(video)) as container:
        pictures = [
            frame.to_ndarray(format="rgb24").transpose(2, 0, 1)
            for frame in container.decode(video=0)
        ]

    def write(draft: Path) -> None:
        with draft.open("wb") as file:
            np.save(file, np.stack(pictures))

    write_whole(target, write)


def read_unpacked(folder: Path) -> None:
    """Replace the reader of the lerobot package in this process.

    Args:
        folder: What :func:`unpack` wrote, of the data set that will be read.
    """
    module = import_module("lerobot.datasets.lerobot_dataset")
    kind = module.DatasetReader
    if not hasattr(kind, _TAKEN):
        vars(module)["DatasetReader"] = unpacked(kind, folder)


def unpacked(kind: type, folder: Path) -> type:
    """Return a kind of reader that finds pictures and numbers in memory.

    Args:
        kind: The one of lerobot. Items are the same, to the bit.
        folder: What :func:`unpack` wrote.
    """

    class Unpacked(kind):  # type: ignore[misc]
        _reads_unpacked = True

        def try_load(self) -> bool:
            there: bool = super().try_load()
            if there:
                # Before the processes that load samples are forked off: they share it.
                self._rows = _Rows.of(self, folder)
            return there

        def get_item(self, idx: int) -> dict[str, Any]:
            return self._rows.item(idx, self.delta_indices or {})

    return Unpacked


@dataclass(frozen=True)
class _Rows:
    """A data set in memory."""

    numbers: dict[str, NDArray[Any]]
    """Columns, (frames, ...)."""
    words: dict[str, pa.ChunkedArray]
    pictures: dict[str, list[NDArray[np.uint8]]]
    """Of each camera and episode, (frames, 3, height, width)."""
    tasks: list[str]
    starts: NDArray[np.int64]
    """First frame of each episode, and after the last one the number of frames."""

    @classmethod
    def of(cls, reader: Any, folder: Path) -> "_Rows":
        """Return what a reader of lerobot reads.

        Raises:
            DatasetError: It shall read something that is not unpacked.
        """
        meta = reader._meta
        if reader.episodes is not None or reader._image_transforms or meta.depth_keys:
            raise DatasetError(
                "Only whole data sets without depth are read unpacked, and pictures as "
                "they are. Use lerobot-train."
            )
        if not reader._return_uint8:
            raise DatasetError("Unpacked pictures are read by lerobot-train alone.")
        table = pq.read_table(reader.root / "data")
        words = {f.name: table[f.name] for f in table.schema if f.type == pa.string()}
        episodes = [meta.episodes[index] for index in range(meta.total_episodes)]
        ends = [episode["dataset_to_index"] for episode in episodes]
        return cls(
            {
                name: _array(table[name])
                for name in table.column_names
                if name not in words
            },
            words,
            {name: [*_pictures(reader, name, folder)] for name in meta.video_keys},
            [str(name) for name in meta.tasks.index],
            np.array([0, *ends]),
        )

    def item(self, index: int, deltas: dict[str, list[int]]) -> dict[str, Any]:
        """Return a sample, with the names and kinds of lerobot.

        Args:
            index: Of the frame.
            deltas: Which frames before and after are wanted, by name.
        """
        torch = import_module("torch")  # lerobot brings it, this package does not
        numbers = {
            name: torch.tensor(rows[index]) for name, rows in self.numbers.items()
        }
        words = {name: rows[index].as_py() for name, rows in self.words.items()}
        found: dict[str, Any] = {**numbers, **words}
        episode = int(numbers["episode_index"])
        first, end = self.starts[episode : episode + 2]
        for name, offsets in deltas.items():
            wanted = index + np.array(offsets)
            outside = (wanted < first) | (wanted >= end)
            found[f"{name}_is_pad"] = torch.from_numpy(outside)
            wanted = wanted.clip(first, end - 1)
            if name in self.pictures:
                rows, wanted = self.pictures[name][episode], wanted - first
            else:
                rows = self.numbers[name]
            found[name] = torch.from_numpy(rows[wanted])
        for name in self.pictures.keys() - deltas.keys():
            picture = self.pictures[name][episode][index - first]
            found[name] = torch.from_numpy(picture.copy())
        found["task"] = self.tasks[int(numbers["task_index"])]
        return found


def _pictures(reader: Any, camera: str, folder: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures of each episode."""
    meta, root = reader._meta, reader.root
    opened: dict[Path, NDArray[np.uint8]] = {}
    for index in range(meta.total_episodes):
        episode = meta.episodes[index]
        path = _unpacked(root, folder, root / meta.get_video_file_path(index, camera))
        if path not in opened:
            opened[path] = np.load(path, mmap_mode="r")
        first = round(episode[f"videos/{camera}/from_timestamp"] * meta.fps)
        count = episode["dataset_to_index"] - episode["dataset_from_index"]
        pictures = opened[path][first : first + count]
        if len(pictures) < count:
            raise DatasetError(f"{path} lacks pictures. Remove it, and unpack again.")
        yield pictures


def _unpacked(root: Path, folder: Path, video: Path) -> Path:
    return folder / video.relative_to(root).with_suffix(_SUFFIX)


def _array(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column as an array; lists have one length."""
    shape: list[int] = [len(column)]
    while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        column = pa.chunked_array([chunk.flatten() for chunk in column.chunks])
        shape.append(len(column) // int(np.prod(shape)))
    return np.ascontiguousarray(column.to_numpy()).reshape(shape)
