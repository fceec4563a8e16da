"""The README of a LeRobotDataset."""

from typing import Any

from lemma.dataset.recipe.card import head

EXTRAS = "extras"
"""Folder of facts that the format has no place for."""
_CARD = """
# LEMMA Bench demonstrations

Two robot arms, one table, one sentence: expert demonstrations of LEMMA Bench as a
LeRobotDataset, made by `lemma render --form lerobot`. {episodes} episodes, {frames}
frames at {fps} per second.

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("you/name", root="this/folder")

`task` is one sentence of each episode, the columns `annotation.instruction.*` are all
three, and `subtask` is what comes next. Do not train on
`annotation.instruction.unseen`: those sentences are held out.

`{extras}/episodes.json` says where each episode comes from and where the cameras are.
`{extras}/` is the recipe of the episodes, too: every instance, and the full state of
the physics at every keyframe. `lemma.load("{extras}")` reads it.

## Features

| name | type | shape |
|---|---|---|
{features}
"""


def card(info: dict[str, Any]) -> str:
    """Return the README of a data set, given its ``meta/info.json``."""
    lines = [
        f"| `{name}` | {each['dtype']} | {' x '.join(map(str, each['shape']))} |"
        for name, each in info["features"].items()
    ]
    files = "configs:\n- config_name: default\n  data_files: data/*/*.parquet\n"
    return head("LeRobot", more=files) + _CARD.format(
        episodes=info["total_episodes"],
        frames=info["total_frames"],
        fps=info["fps"],
        extras=EXTRAS,
        features="\n".join(lines),
    )
