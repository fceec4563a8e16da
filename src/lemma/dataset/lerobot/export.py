"""Export of a recipe as a LeRobotDataset v3.0 with the lerobot package.

Each job writes a few episodes as a separate LeRobotDataset, a shard, completely or not
at all. When all shards exist, lerobot aggregates them, and ``meta`` is written last. An
interrupted run loses only unfinished shards; the next run continues.
"""

import importlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from itertools import product
from pathlib import Path
from shutil import rmtree
from time import perf_counter
from typing import Any

from lemma.core.errors import DatasetError
from lemma.core.files import (
    only_writer,
    read_json,
    sha256_of,
    write_json,
    write_text,
)
from lemma.core.workers.pool import Engine
from lemma.core.workers.resumable import NEW_FOLDER, PARTS, Part, begin, do_missing
from lemma.dataset.files import CARD, card
from lemma.dataset.lerobot.aggregate import REPO_ID, aggregate_in_groups, silence
from lemma.dataset.lerobot.frames import (
    Style,
    describe_episode,
    features,
    frames,
    robots_of,
)
from lemma.dataset.lerobot.sources import (
    check_source,
    keep_source,
    name_in_source,
    read_records,
)
from lemma.dataset.lerobot.statistics import widened
from lemma.dataset.recipe.files import versions
from lemma.dataset.rendered.render import RenderConfig, RenderSummary
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.names import task_rank

EXTRAS = "extras"
"""Folder for data that the format cannot store."""
INFO, STATS = "meta/info.json", "meta/stats.json"
EPISODES = f"{EXTRAS}/episodes.json"
"""File with data about every episode that the format cannot store."""
_EXPORT = f"{EXTRAS}/export.json"
_WHOLE = ".whole"
_PARTS = ("data", "videos", "meta")
"""Folders of a LeRobotDataset; the last one is moved last, which completes it."""
DEPTH_LARGEST_M = 4.095
"""Largest stored depth [m]; levels are 1 mm apart. Cameras above the table see at most
3.8 m."""


@dataclass(frozen=True, kw_only=True)
class LeRobotConfig:
    """The settings of an export."""

    source: RenderConfig
    """Selection of episodes, and the output folder."""
    style: Style = field(default_factory=Style)
    """Options of the frames."""
    per_video: int = 10
    """Number of episodes per video. Readers find frames by time in float32, to within
    0.1 ms, so a video should be shorter than 1000 s."""

    @property
    def per_shard(self) -> int:
        """Number of the recipe's episodes per video; each is there once per kind."""
        return max(1, self.per_video // len(self.style.instructions))

    @property
    def out(self) -> Path:
        """Folder of the data set."""
        return self.source.out

    def shards(self) -> "list[Shard]":
        """Return the shards: training first, then in the suite's order.

        Raises:
            DatasetError: There is no recipe.
            UnknownNameError: The recipe has no such task or split.
        """
        groups = sorted(self.source.groups(), key=lambda group: _rank(*group[:2]))
        every = [
            # Absolute paths, since workers of a cluster have another working folder.
            (path.absolute(), group, rows[first : first + self.per_shard])
            for path, group, rows in groups
            for first in range(0, len(rows), self.per_shard)
        ]
        folder = (self.out / PARTS).absolute()
        return [
            Shard(*one, folder / f"{number:06d}") for number, one in enumerate(every)
        ]


@dataclass(frozen=True, slots=True)
class Shard:
    """Episodes that one job writes as a separate LeRobotDataset."""

    path: Path
    """File of the recipe."""
    group: int
    """Row group of the file."""
    rows: tuple[int, ...]
    """Rows of the group."""
    folder: Path
    """Folder of the shard, until all shards exist."""


def _rank(path: Path, group: int) -> tuple[int, tuple[int, str], str, int]:
    split = path.parent.name
    rank = [*SPLITS, split].index(split)
    return rank, task_rank(path.stem), path.as_posix(), group


def write_dataset(
    order: LeRobotConfig,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> RenderSummary:
    """Write the shards that a LeRobotDataset lacks, and assemble it.

    Args:
        order: The settings.
        engine: Workers that run the jobs.
        advance: Called with the numbers of existing and of newly finished episodes.

    Returns:
        The outcome.

    Raises:
        DatasetError: The lerobot package is not installed; the recipe cannot be read
            here; the folder was made from another recipe or with other options; a file
            cannot be written; or held-out sentences would be used for training.
        UnknownNameError: The recipe has no such task or split, or no such camera.
        RenderingError: OpenGL does not work here.
    """
    start = perf_counter()
    shards = order.shards()
    files = list(dict.fromkeys(shard.path for shard in shards))
    check_source(order.source.recipe, files, order.style)
    check_installed()
    for shard in shards[:1]:
        features(
            robots_of(read_records(shard.path, shard.group, shard.rows)[0]), order.style
        )
    total = sum(len(shard.rows) for shard in shards)
    with only_writer(order.out):
        _begin(order, files)
        is_whole = (order.out / INFO).exists()
        parts = [
            Part(
                (shard, order.style), len(shard.rows), is_whole or shard.folder.exists()
            )
            for shard in shards
        ]
        for part, _ in do_missing(parts, write_shard, engine, advance):
            advance(part.size)
        if not is_whole:
            _assemble(order, shards, files, engine)
        rmtree(order.out / PARTS, ignore_errors=True)
    count = read_json(order.out / INFO)["total_frames"]
    size = sum(path.stat().st_size for path in order.out.rglob("*") if path.is_file())
    made = sum(part.size for part in parts if not part.is_done)
    return RenderSummary(total, count, made, perf_counter() - start, size / 1e6)


def check_installed() -> None:
    """Check that the lerobot package is installed.

    Raises:
        DatasetError: It is not installed.
    """
    try:
        importlib.import_module("lerobot")
    except ImportError as error:
        raise DatasetError(
            "LeRobotDatasets need the lerobot package, which is not installed. It "
            "needs Python 3.12 or newer, and torch: make a separate environment, "
            "python3.12 -m venv .venv-lerobot, and install with "
            ".venv-lerobot/bin/pip install 'lemma-bench[lerobot]', or '.[lerobot]' in "
            "a checkout. A recipe may be generated elsewhere."
        ) from error


def _begin(order: LeRobotConfig, files: Sequence[Path]) -> None:
    """Write the record of the export, or check that an existing one is the same.

    Raises:
        DatasetError: The folder contains another export or other files.
    """
    about = {
        "form": "lerobot",
        "versions": {**versions(BENCHMARK_VERSION), "lerobot": version("lerobot")},
        **asdict(order.style),
        "renderer": order.style.rig().describe() if order.style.images else None,
        "per_video": order.per_video,
        "recipe": {name_in_source(path): sha256_of(path) for path in files},
    }
    path = order.out / _EXPORT
    others = (name for name in order.out.iterdir() if not name.name.startswith("."))
    if not path.exists() and any(others):
        raise DatasetError(
            f"{order.out} contains files of something else. {NEW_FOLDER}"
        )
    begin(order.out, _EXPORT, about)


def write_shard(shard: Shard, style: Style) -> None:
    """Write some episodes as a LeRobotDataset.

    Args:
        shard: The episodes.
        style: Options of the frames.

    Raises:
        DatasetError: The replayed motion differs from the recorded one.
        RenderingError: OpenGL does not work here.
    """
    records = read_records(shard.path, shard.group, shard.rows)
    draft = shard.folder.with_name(f".{shard.folder.name}")
    rmtree(draft, ignore_errors=True)
    dataset = _create(draft, features(robots_of(records[0]), style), style)
    known = []
    for record, kind in product(records, style.instructions):
        length = 0
        for frame in frames(record, style, kind):
            dataset.add_frame(frame)
            length += 1
        # Workers may not start further processes.
        dataset.save_episode(parallel_encoding=False)
        known.append(describe_episode(record, style, kind, length))
    dataset.finalize()
    write_json(draft / EPISODES, {"episodes": known})
    draft.rename(shard.folder)


def _create(folder: Path, holds: dict[str, dict[str, Any]], style: Style) -> Any:
    """Return a new LeRobotDataset.

    It does not use lerobot's streaming encoder, which is made for real cameras and
    drops frames when it is too slow.
    """
    silence()
    from lerobot.configs import DepthEncoderConfig, RGBEncoderConfig  # noqa: PLC0415
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: PLC0415

    # For fast random access: every fifth frame is a keyframe, without B-frames. Without
    # macroblock trees, crf 27 has the quality and size of crf 23 with them.
    color = {"bf": "0", "x264-params": "mbtree=0"}
    # Lossless, one thread, no log.
    x265 = "lossless=1:pools=none:frame-threads=1:log-level=none"
    levels = {"bf": "0", "x265-params": x265}
    return LeRobotDataset.create(
        REPO_ID,
        style.fps,
        holds,
        root=folder,
        robot_type="lemma_team",
        rgb_encoder=RGBEncoderConfig(
            vcodec="h264", g=5, crf=27, preset="veryfast", extra_options=color
        ),
        depth_encoder=DepthEncoderConfig(
            depth_min=0.0,
            depth_max=DEPTH_LARGEST_M,
            use_log=False,
            g=5,
            crf=None,
            preset="superfast",
            extra_options=levels,
        ),
        encoder_threads=1,
    )


def _assemble(
    order: LeRobotConfig,
    shards: Sequence[Shard],
    files: Sequence[Path],
    engine: Engine,
) -> None:
    """Aggregate the shards, and add the files outside of the format.

    Raises:
        DatasetError: The episodes have different numbers of robots.
    """
    episodes = [
        episode
        for shard in shards
        for episode in read_json(shard.folder / EPISODES)["episodes"]
    ]
    if len({len(episode["team"].split("+")) for episode in episodes}) > 1:
        raise DatasetError(
            "These episodes have different numbers of robots and do not fit into one "
            "LeRobotDataset. Export the tasks into separate folders, with --tasks."
        )
    whole = order.out / PARTS / _WHOLE
    aggregate_in_groups([shard.folder for shard in shards], whole, engine)
    info = read_json(whole / INFO)
    info["splits"] = dict(_splits(episodes))
    write_json(whole / INFO, info)
    write_json(whole / STATS, widened(read_json(whole / STATS)))
    write_json(
        order.out / EPISODES,
        {"episodes": [{"episode_index": n, **e} for n, e in enumerate(episodes)]},
    )
    keep_source(order.out / EXTRAS, files)
    rows = "\n".join(
        f"| `{name}` | {each['dtype']} | {' x '.join(map(str, each['shape']))} |"
        for name, each in info["features"].items()
    )
    text = card(
        "lerobot",
        episodes=info["total_episodes"],
        frames=info["total_frames"],
        fps=info["fps"],
        features=rows,
    )
    write_text(order.out / CARD, text)
    for part in _PARTS:
        rmtree(order.out / part, ignore_errors=True)
        # Without images there are no videos.
        if (whole / part).exists():
            (whole / part).rename(order.out / part)


def _splits(episodes: Sequence[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield each split with the range of its episodes, ``"0:5600"``."""
    names = [episode["split"] for episode in episodes]
    for name in dict.fromkeys(names):
        first = names.index(name)
        yield name, f"{first}:{first + names.count(name)}"
