"""The README of a LeRobotDataset, with the header that the Hugging Face Hub reads."""

from typing import Any

from lemma.dataset.lerobot.layout import CODEBASE_VERSION, EXTRAS

_CARD = """---
license: cc-by-4.0
task_categories:
- robotics
language:
- en
tags:
- LeRobot
- multi-robot
- language-conditioned
- manipulation
- mujoco
pretty_name: LEMMA Bench demonstrations
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# LEMMA Bench demonstrations

Two robot arms, one table, one sentence: expert demonstrations of LEMMA Bench as a
LeRobotDataset {version}, made by `lemma render --form lerobot`. {episodes} episodes,
{frames} frames at {fps} per second.

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("you/name", root="this/folder")

Depth needs lerobot 0.6 or newer. `task` is one sentence of each episode; the columns
`annotation.instruction.*` number the other ones in `meta/tasks.parquet`. Do not train
on `annotation.instruction.unseen`: those sentences are held out.

`{extras}/` is the recipe of the episodes: every instance, and the full state of the
physics at every keyframe. `lemma.load("{extras}")` reads it.

## Features

| name | type | shape |
|---|---|---|
{features}
"""


def card(info: dict[str, Any]) -> str:
    """Return the README of a data set.

    Args:
        info: What its ``meta/info.json`` says.
    """
    lines = [
        f"| `{name}` | {each['dtype']} | {' x '.join(map(str, each['shape']))} |"
        for name, each in info["features"].items()
    ]
    return _CARD.format(
        version=CODEBASE_VERSION,
        episodes=info["total_episodes"],
        frames=info["total_frames"],
        fps=info["fps"],
        extras=EXTRAS,
        features="\n".join(lines),
    )
