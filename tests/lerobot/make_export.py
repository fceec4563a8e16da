"""Write a small LeRobotDataset and what must be found in it, for check_lerobot.py.

Run in the environment of the package; lerobot is not needed.
"""

import json
import sys
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
from in_process import Serial

from lemma.dataset.lerobot.export import LeRobotConfig, write_dataset
from lemma.dataset.lerobot.layout import Style
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.recipe.reader import load
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.labels import label
from lemma.dataset.rendered.render import RenderConfig
from lemma.dataset.rendered.steps import iterate_steps
from lemma.scene.rendering.renderer import Renderer

# With files so small that the episodes need several.
STYLE = Style(fps=10, width_px=320, height_px=240, data_file_mb=0.05, video_file_s=40)
EVERY = 17
"""Frames from one picture that is kept to the next."""
_TOLD = ("key", "task", "split", "high_level", "human", "unseen", "success")
_KEPT = ("state", "action", "subtask", "rgb", "depth", "at")


def main() -> None:
    """Write ``dataset/`` and what it must hold into a folder."""
    out = Path(sys.argv[1])
    rmtree(out, ignore_errors=True)
    recipe = out / "recipe"
    tasks, splits = ("pass", "stack"), ("train", "val")
    generate(
        GenerateConfig(out=recipe, tasks=tasks, splits=splits, episodes=1), Serial()
    )
    source = RenderConfig(recipe=recipe, out=out / "dataset")
    write_dataset(LeRobotConfig(source=source, style=STYLE), Serial())
    expected = []
    for split in splits:
        for task in tasks:
            record = load(recipe).find(task, split, 0)
            arrays = _watch(record)
            np.savez(out / f"{split}-{task}.npz", **arrays)
            ends = range(len(record.subtasks) + 1)
            words = [label(record, number)["sub_instruction"] for number in ends]
            told = {name: getattr(record, name) for name in _TOLD}
            length = len(arrays["subtask"])
            expected.append({**told, "subtasks": words, "length": length})
    files = len(list((out / "dataset/data").rglob("*.parquet")))
    description = {"fps": STYLE.fps, "episodes": expected, "data_files": files}
    (out / "expected.json").write_text(json.dumps(description, indent=1))


def _watch(record: EpisodeRecord) -> dict[str, Any]:
    renderer = Renderer(STYLE.width_px, STYLE.height_px)
    found: dict[str, list[Any]] = {name: [] for name in _KEPT}
    for step in iterate_steps(record, STYLE.fps):
        state = np.concatenate([step.joints, step.opening_m[:, None]], axis=1)
        found["state"].append(state.ravel())
        found["action"].append(step.action.ravel())
        found["subtask"].append(step.subtask)
        if step.index % EVERY == 0 or step.is_done:
            images = [
                renderer.rgbd(step.scene.model, step.scene.data, f"robot_{i}/camera")
                for i in range(2)
            ]
            found["at"].append(step.index)
            found["rgb"].append([image.rgb for image in images])
            found["depth"].append([image.depth_m for image in images])
    return {name: np.array(values) for name, values in found.items()}


if __name__ == "__main__":
    main()
