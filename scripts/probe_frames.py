"""Measure what the image network of an Episodic Transformer sees.

    python scripts/probe_frames.py episodic-transformer

A small network learns to answer questions from the cells of the first frame, those from
which the token is made. It is shown instances of the training split of *pass*, *pass2*,
*stack* and *stack2*, and asked about others of the same split. Some questions are asked
about each color, or each cube. Each has two answers; printed are how often the answer
is right, and how often the more frequent one would be. If it is right no more often,
this network finds no answer in the cells.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.poses import Pose2
from lemma.env.camera_rig import CameraRig
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.models.episodic_transformer import EpisodicTransformer
from lemma.policies.weights import load_model
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks.instance import Instance
from lemma.tasks.suite import load_instance

TASKS = ("pass", "pass2", "stack", "stack2")
EPOCHS, BATCH = 30, 64
HELD_OUT = 5
"""One of so many instances is asked about."""
_APART_M = 2.2
_COLORS = tuple(OBJECT_COLORS)
_ALL = torch.ones(len(_COLORS))
"""Stands for no color in a question."""


@dataclass(frozen=True)
class Seen:
    """The first frame of an instance."""

    cells: Tensor
    answers: Mapping[str, Sequence[tuple[Tensor, bool]]]
    """To each question, with the color asked about as zeros and a one, (colors,)."""


def answers_of(instance: Instance) -> dict[str, list[tuple[Tensor, bool]]]:
    """Return the true answers."""
    scene = instance.scene
    cubes = {o.color: o.pose for o in scene.objects if o.kind == "cube"}
    first, second = ((robot.base.x, robot.base.y) for robot in scene.robots)

    def nearer(cube: Pose2) -> bool:
        at = cube.x, cube.y
        return math.dist(at, first) < math.dist(at, second)

    return {
        "do the robots stand far apart": [(_ALL, math.dist(first, second) > _APART_M)],
        "is the first robot at +y": [(_ALL, first[1] > 0)],
        "are there more than two cubes": [(_ALL, len(cubes) > 2)],
        "is there a cube of this color": [(_hot(c), c in cubes) for c in _COLORS],
        "is this cube nearer to the first robot": [
            (_hot(color), nearer(cube)) for color, cube in cubes.items()
        ],
    }


def _hot(color: str) -> Tensor:
    return torch.eye(len(_COLORS))[_COLORS.index(color)]


def look(model: EpisodicTransformer, instances: int) -> list[Seen]:
    """Return the first frames of the first instances of each task."""
    rig, found = CameraRig(), []
    for task in TASKS:
        for index in range(instances):
            instance = load_instance(task, "train", index)
            given = Rollout(instance).policy_input(rig)
            with torch.inference_mode():
                cells = model._cells_of([given.view])[0].clone()
            found.append(Seen(cells, answers_of(instance)))
    return found


class Probe(nn.Module):
    """Answers a question about a color from cells."""

    def __init__(self, numbers: int) -> None:
        """Make the weights, for so many numbers of a frame."""
        super().__init__()
        self.cells = nn.Linear(numbers, 256)
        self.color = nn.Linear(len(_COLORS), 256)
        self.answer = nn.Sequential(
            nn.ReLU(), nn.Dropout(0.3), nn.Linear(256, 64), nn.ReLU(), nn.Linear(64, 1)
        )

    def forward(self, cells: Tensor, color: Tensor) -> Tensor:
        """Return the score of yes, (B,)."""
        # A product, because where to look depends on the color.
        told: Tensor = self.answer(self.cells(cells) * self.color(color))
        return told.squeeze(1)


def ask(seen: Sequence[Seen], question: str) -> tuple[float, float]:
    """Return how often the more frequent answer is right, and the learned one."""
    torch.manual_seed(0)
    cells = torch.stack([one.cells for one in seen])
    cells = (cells - cells.mean(0)) / (cells.std(0) + 1e-5)
    asked = [(n, *one) for n, each in enumerate(seen) for one in each.answers[question]]
    frame = torch.tensor([number for number, _, _ in asked])
    color = torch.stack([one for _, one, _ in asked])
    wanted = torch.tensor([float(answer) for _, _, answer in asked])
    held = frame % HELD_OUT == 0
    probe = Probe(cells.shape[1])
    optimiser = torch.optim.AdamW(probe.parameters(), 5e-4, weight_decay=0.1)
    known = torch.nonzero(~held).flatten()
    for _ in range(EPOCHS):
        for part in known[torch.randperm(len(known))].split(BATCH):
            told = probe(cells[frame[part]], color[part])
            optimiser.zero_grad()
            F.binary_cross_entropy_with_logits(told, wanted[part]).backward()
            optimiser.step()
    probe.eval()
    with torch.inference_mode():
        right = (probe(cells[frame[held]], color[held]) > 0) == (wanted[held] > 0.5)
    share = float(wanted[held].mean())
    return max(share, 1.0 - share), float(right.double().mean())


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weights")
    parser.add_argument("--instances", type=int, default=400, help="of each task")
    options = parser.parse_args()
    torch.set_num_threads(1)
    model = load_model(options.weights)
    assert isinstance(model, EpisodicTransformer)
    seen = look(model, options.instances)
    for question in seen[0].answers:
        common, right = ask(seen, question)
        print(f"{question}? {right:.1%} (always the same: {common:.1%})", flush=True)


if __name__ == "__main__":
    main()
