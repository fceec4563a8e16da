"""LeRobotDatasets out of several smaller ones."""

import logging
import math
import os
from collections.abc import Sequence
from pathlib import Path
from shutil import rmtree

from lemma.core.workers.pool import Engine

REPO_ID = "lemma/export"
"""Name of the data sets, which lerobot requires."""
_GROUP = ".group"
_FEW = 4
"""Number of data sets up to which no groups are made."""


def aggregate_in_groups(folders: Sequence[Path], whole: Path, engine: Engine) -> None:
    """Aggregate LeRobotDatasets into one in parallel, in their order.

    Args:
        folders: Folders of the data sets; temporary groups are written next to them.
        whole: Output folder; an existing one is replaced.
        engine: Workers that run the jobs.
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
    """Aggregate LeRobotDatasets into one, in their order.

    Args:
        folders: Folders of the data sets.
        whole: Output folder; an existing one is replaced.
    """
    silence()
    from lerobot.datasets.aggregate import aggregate_datasets  # noqa: PLC0415

    rmtree(whole, ignore_errors=True)
    aggregate_datasets(
        [REPO_ID] * len(folders),
        REPO_ID,
        roots=[*folders],
        aggr_root=whole,
        # Concatenated videos would be too long to find frames by time. Concatenated
        # tables would be rewritten for every shard.
        concatenate_videos=False,
        concatenate_data=False,
    )


def silence() -> None:
    """Suppress output of encoders and tables, which would disturb the progress bar."""
    os.environ.setdefault("TQDM_DISABLE", "1")
    logging.getLogger("lerobot").setLevel(logging.ERROR)
    import av  # noqa: PLC0415
    import datasets  # noqa: PLC0415

    av.logging.set_libav_level(av.logging.ERROR)
    datasets.disable_progress_bars()
