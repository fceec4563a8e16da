"""A small LeRobotDataset, written once for several tests, and how to look into it."""

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from in_process import Serial
from rendered_sets import recipe_folder, scratch

from lemma.dataset.lerobot.export import LeRobotConfig, write_dataset
from lemma.dataset.lerobot.layout import Style, features
from lemma.dataset.rendered.render import RenderConfig, RenderSummary

FPS = 2
# Videos so short that two episodes do not fit into one.
STYLE = Style(fps=FPS, width_px=96, height_px=72, video_file_s=40, data_file_mb=0.015)
ROBOTS = ("robot_0", "robot_1")
VIDEOS = tuple(name for name, f in features(ROBOTS, STYLE).items() if "info" in f)


def order(out: Path, style: Style = STYLE, **changes: Any) -> LeRobotConfig:
    source = RenderConfig(recipe=recipe_folder(), out=out, **changes)
    return LeRobotConfig(source=source, style=style)


@cache
def written() -> tuple[Path, RenderSummary]:
    folder = scratch() / "lerobot"
    return folder, write_dataset(order(folder), Serial())


def folder() -> Path:
    return written()[0]


def decode_at(path: Path, times: Sequence[float], pixels: str) -> list[np.ndarray]:
    """Return the frames of a video at times, each sought from the frames before."""
    found = []
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        for time_s in times:
            assert stream.time_base is not None
            offset = max(0, round(time_s / stream.time_base))
            container.seek(offset, stream=stream, backward=True)
            for frame in container.decode(stream):
                if frame.time is not None and frame.time > time_s - 1e-4:
                    assert frame.time == pytest.approx(time_s, abs=1e-4)
                    found.append(frame.to_ndarray(format=pixels))
                    break
    assert len(found) == len(times)
    return found


def psnr_db(ours: np.ndarray, theirs: np.ndarray) -> float:
    off = ours.astype(float) - theirs.astype(float)
    return 10 * math.log10(255**2 / float((off**2).mean()))
