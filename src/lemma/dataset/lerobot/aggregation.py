"""Many LeRobotDatasets become one: lerobot does it, in groups at the same time.

It takes half a second and more for each of them, and would write a table that grows
again for each: for hundreds, longer than all rendering.
"""

import logging
import math
import os
from collections.abc import Sequence
from pathlib import Path
from shutil import rmtree

from lemma.core.workers.pool import Engine

REPO_ID = "lemma/export"
"""Name of the data sets, which lerobot asks for."""
_GROUP = ".group"
_FEW = 4
"""Data sets that are never divided into groups."""


def aggregate_in_groups(folders: Sequence[Path], whole: Path, engine: Engine) -> None:
    """Write one LeRobotDataset that holds the episodes of others, in their order.

    Args:
        folders: Of the others; groups of them are written beside them.
        whole: Folder to write; what is there is replaced.
        engine: Where to work.
    """
    size = max(_FEW, math.isqrt(len(folders)))
    if len(folders) > size:
        groups = [
            folders[first : first + size] for first in range(0, len(folders), size)
        ]
        folders = [group[0].with_suffix(_GROUP) for group in groups]
        for _ in engine.run(aggregate, [*zip(groups, folders, strict=True)]):
            pass
    aggregate(folders, whole)


def aggregate(folders: Sequence[Path], whole: Path) -> None:
    """Write one LeRobotDataset that holds the episodes of others, in their order.

    Args:
        folders: Of the others.
        whole: Folder to write; what is there is replaced.
    """
    silence()
    from lerobot.datasets.aggregate import aggregate_datasets  # noqa: PLC0415

    rmtree(whole, ignore_errors=True)
    aggregate_datasets(
        [REPO_ID] * len(folders),
        REPO_ID,
        roots=[*folders],
        aggr_root=whole,
        # Joined videos would be longer than readers can look frames up in, and of a
        # table that grows all rows would be written again for every shard.
        concatenate_videos=False,
        concatenate_data=False,
    )


def silence() -> None:
    """Keep encoders and tables from talking over the progress bar."""
    os.environ.setdefault("TQDM_DISABLE", "1")
    logging.getLogger("lerobot").setLevel(logging.ERROR)
    import av  # noqa: PLC0415
    import datasets  # noqa: PLC0415

    av.logging.set_libav_level(av.logging.ERROR)
    datasets.disable_progress_bars()
