"""Measure how often policies decide rightly before and after a mistake.

On perturbed executions of the validation split, which nothing was trained on:

    lemma generate --perturb 0.3 --split val --episodes 12 --out out/mistakes
    lemma render out/mistakes --form keyframes --out out/mistakes-keyframes
    python scripts/measure_recovery.py out/mistakes-keyframes reachnet runs/no-recovery

A decision is right if robot, primitive and objects are the expert's in that state.
"""

import argparse
from collections.abc import Iterator

import torch

from lemma.dataset.rendered.keyframes.memory import MapsInMemory
from lemma.expert.disturbances import NONE
from lemma.policies.batch import Frames
from lemma.policies.model import Model
from lemma.policies.weights import load_model

SPLIT = "val"
AT_ONCE = 4
"""Episodes."""


def after_a_mistake(folder: str, frames: Frames) -> list[bool]:
    """Return for each frame whether a sub-task before it was perturbed."""
    kinds = MapsInMemory.load(folder, SPLIT, (), ("perturbation",)).columns
    wrong = [kind != NONE for kind in kinds["perturbation"]]
    return [any(wrong[rows.start : i]) for rows in frames.episodes for i in rows]


def right(model: Model, frames: Frames) -> Iterator[bool]:
    """Yield for each frame whether the model's plan is right."""
    episodes = frames.episodes
    for start in range(0, len(episodes), AT_ONCE):
        rows = [i for each in episodes[start : start + AT_ONCE] for i in each]
        with torch.inference_mode():
            yield from (model.score(frames.batch(rows))["plan"] == 1).tolist()


def main() -> None:
    """Print one line per policy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="rendered keyframes of perturbed executions")
    parser.add_argument("weights", nargs="+", help="by name, file or folder")
    args = parser.parse_args()
    frames = Frames.load(args.folder, SPLIT)
    after = after_a_mistake(args.folder, frames)
    print(f"{len(after)} frames, {sum(after)} of them after a mistake")
    for name in args.weights:
        found = list(right(load_model(name).eval(), frames))
        for words, wanted in (("before", False), ("after", True)):
            values = [ok for ok, a in zip(found, after, strict=True) if a is wanted]
            print(f"{name} {words}: {100 * sum(values) / len(values):.1f} %")


if __name__ == "__main__":
    main()
