r"""Run lerobot-train on images that are decoded once.

    python scripts/lerobot_train_unpacked.py unpack data/videos /dev/shm/videos
    python scripts/lerobot_train_unpacked.py train /dev/shm/videos \
        --dataset.repo_id=you/lemma --dataset.root=data/videos --policy.type=act ...

lerobot opens a video for every image, and searches a row for every number. Here all
trainings on a machine map the decoded images into memory, and samples are equal to the
bit. A file's name is the hash of its video, so that images of another export are never
used. Arguments after the folder of ``train`` are those of ``lerobot-train``.
"""

import sys
from collections.abc import Iterator
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
from lemma.core.files import only_writer, sha256_of, write_whole
from lemma.core.workers.pool import Engine, ProcessPool
from lemma.core.workers.resources import usable_cores
from lemma.dataset.lerobot.export import INFO

FORK = "fork"
"""Start method of processes, with which the loaders share this one's memory."""
_SUFFIX = ".npy"
_MARK = "_reads_unpacked"
_VIDEOS = "videos"


def unpack(root: Path, folder: Path, engine: Engine) -> int:
    """Decode all videos of a data set; existing files are kept.

    Args:
        root: Folder of the data set.
        folder: Folder of the images, with width × height × 3 bytes each.
        engine: Workers that run the jobs.

    Returns:
        The number of videos.

    Raises:
        DatasetError: There is no data set, or the disk is full.
    """
    if not (root / INFO).is_file():
        raise DatasetError(f"There is no LeRobotDataset in {root}.")
    videos = sorted((root / _VIDEOS).rglob("*.mp4"))
    with only_writer(folder):
        targets = [(video, _unpacked(folder, video)) for video in videos]
        jobs = [(video, target) for video, target in targets if not target.exists()]
        for _ in engine.run(decode, jobs):
            pass
    return len(videos)


def decode(video: Path, target: Path) -> None:
    """Write all images of a video as an array (frames, 3, height, width), uint8."""
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
        folder: Output of :func:`unpack` for the data set to read.
    """
    module = import_module("lerobot.datasets.lerobot_dataset")
    kind = module.DatasetReader
    if not hasattr(kind, _MARK):
        vars(module)["DatasetReader"] = unpacked(kind, folder)


def unpacked(kind: type, folder: Path) -> type:
    """Return a subclass of a reader that reads images and numbers from memory.

    Args:
        kind: lerobot's reader. Its items are equal to the bit.
        folder: Output of :func:`unpack`.
    """

    class Unpacked(kind):
        _reads_unpacked = True

        def try_load(self) -> bool:
            there: bool = super().try_load()
            if there:
                # Before the fork of the loaders, so that they share this memory.
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
    """By camera, for each episode, (frames, 3, height, width)."""
    tasks: list[str]
    starts: NDArray[np.int64]
    """First frame of each episode, followed by the number of frames."""

    @classmethod
    def of(cls, reader: Any, folder: Path) -> "_Rows":
        """Return the data of lerobot's reader.

        Raises:
            DatasetError: Its options need data that are not unpacked.
        """
        meta = reader._meta
        if reader.episodes is not None or reader._image_transforms or meta.depth_keys:
            raise DatasetError(
                "Unpacked reading supports only whole data sets without depth and "
                "without transforms of images. Use lerobot-train."
            )
        if not reader._return_uint8:
            raise DatasetError("Only lerobot-train can read unpacked images.")
        table = pq.read_table(reader.root / "data")
        words = {f.name: table[f.name] for f in table.schema if _is_text(f.type)}
        numbers = [name for name in table.column_names if name not in words]
        starts = np.array([0, *meta.episodes["dataset_to_index"]])
        return cls(
            {name: _array(table[name]) for name in numbers},
            words,
            {
                camera: [*_pictures(reader, camera, np.diff(starts), folder)]
                for camera in meta.video_keys
            },
            [str(name) for name in meta.tasks.index],
            starts,
        )

    def item(self, index: int, deltas: dict[str, list[int]]) -> dict[str, Any]:
        """Return a sample, with the names and types of lerobot.

        Args:
            index: Index of the frame.
            deltas: Offsets of the frames before and after it, by name.
        """
        torch = import_module("torch")  # a dependency of lerobot, not of this package
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


def _pictures(
    reader: Any, camera: str, lengths: NDArray[np.int64], folder: Path
) -> Iterator[NDArray[np.uint8]]:
    """Yield the images of each episode.

    Raises:
        DatasetError: A video is not unpacked.
    """
    meta = reader._meta
    opened: dict[Path, NDArray[np.uint8]] = {}
    begins = meta.episodes[f"videos/{camera}/from_timestamp"]
    for index, (begin_s, length) in enumerate(zip(begins, lengths, strict=True)):
        video = reader.root / meta.get_video_file_path(index, camera)
        if video not in opened:
            path = _unpacked(folder, video)
            if not path.is_file():
                raise DatasetError(
                    f"{video} is not unpacked in {folder}. Unpack first."
                )
            opened[video] = np.load(path, mmap_mode="r")
        first = round(begin_s * meta.fps)
        yield opened[video][first : first + length]


def _is_text(kind: pa.DataType) -> bool:
    # The type is large_string after an aggregation of many data sets.
    return kind in (pa.string(), pa.large_string())


def _unpacked(folder: Path, video: Path) -> Path:
    return folder / f"{sha256_of(video)}{_SUFFIX}"


def _array(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column as an array; lists have one length."""
    shape: list[int] = [len(column)]
    while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        column = pa.chunked_array([chunk.flatten() for chunk in column.chunks])
        shape.append(len(column) // int(np.prod(shape)))
    return np.ascontiguousarray(column.to_numpy()).reshape(shape)


def main() -> None:
    """Run the command line."""
    match sys.argv[1:]:
        case ["unpack", root, folder]:
            count = unpack(Path(root), Path(folder), ProcessPool(usable_cores()))
            print(f"{folder}: {count} videos.")
        case ["train", folder, *arguments]:
            read_unpacked(Path(folder))
            sys.argv[1:] = [f"--dataloader_multiprocessing_context={FORK}", *arguments]
            import_module("lerobot.scripts.lerobot_train").main()
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
