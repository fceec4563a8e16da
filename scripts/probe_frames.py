"""Measure what the image network of an Episodic Transformer sees.

    python scripts/probe_frames.py episodic-transformer

A small network learns to answer questions from the cells of the first frame, those from
which the token is made. It is shown instances of the training split of *pass*, *pass2*,
*stack* and *stack2*, and asked about others of the same split. Each question has two
answers; printed are how often the more frequent one is right, and how often the answer
is. If it is right no more often, the cells do not tell.
"""

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.env.camera_rig import CameraRig
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.models.episodic_transformer import EpisodicTransformer
from lemma.policies.weights import load_model
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks.instance import Instance
from lemma.tasks.suite import load_instance

TASKS = ("pass", "pass2", "stack", "stack2")
EPOCHS, BATCH = 15, 64
HELD_OUT = 5
"""One of so many instances is asked about."""
_APART_M = 2.2


@dataclass(frozen=True)
class Seen:
    """The first frame of an instance."""

    cells: Tensor
    named: Tensor
    """Which cube shall be moved, as zeros and a one, (colors,)."""
    answers: Mapping[str, bool]


def answers_of(instance: Instance) -> dict[str, bool]:
    """Return the true answers."""
    scene = instance.scene
    cubes = {o.color: o.pose for o in scene.objects if o.kind == "cube"}
    first, second = (robot.base for robot in scene.robots)
    named = cubes[_color(instance)]
    here, there = (math.dist((named.x, named.y), (b.x, b.y)) for b in (first, second))
    return {
        "do the robots stand far apart": math.dist(
            (first.x, first.y), (second.x, second.y)
        )
        > _APART_M,
        "is the first robot at +y": first.y > 0,
        "is there a red cube": "red" in cubes,
        "is there a blue cube": "blue" in cubes,
        "are there more than two cubes": len(cubes) > 2,
        "is the named cube nearer to the first robot": here < there,
    }


def _color(instance: Instance) -> str:
    return instance.goal.conjuncts[0].top.removesuffix("_cube")


def look(model: EpisodicTransformer, instances: int) -> list[Seen]:
    """Return the first frames of the first instances of each task."""
    rig, found = CameraRig(), []
    for task in TASKS:
        for index in range(instances):
            instance = load_instance(task, "train", index)
            given = Rollout(instance).policy_input(rig)
            with torch.inference_mode():
                cells = model._cells_of([given.view])[0].clone()
            number = torch.tensor(list(OBJECT_COLORS).index(_color(instance)))
            named = F.one_hot(number, len(OBJECT_COLORS)).float()
            found.append(Seen(cells, named, answers_of(instance)))
    return found


def ask(seen: list[Seen], question: str) -> tuple[float, float]:
    """Return how often the more frequent answer is right, and the learned one."""
    torch.manual_seed(0)
    cells = torch.stack([one.cells for one in seen])
    cells = (cells - cells.mean(0)) / (cells.std(0) + 1e-5)
    given = torch.cat([cells, torch.stack([one.named for one in seen])], 1)
    wanted = torch.tensor([float(one.answers[question]) for one in seen])
    held = torch.arange(len(seen)) % HELD_OUT == 0
    net = nn.Sequential(
        nn.Linear(given.shape[1], 256), nn.ReLU(), nn.Dropout(0.3), nn.Linear(256, 1)
    )
    optimiser = torch.optim.AdamW(net.parameters(), 3e-4, weight_decay=0.05)
    known = torch.nonzero(~held).flatten()
    for _ in range(EPOCHS):
        for part in known[torch.randperm(len(known))].split(BATCH):
            told = net(given[part]).squeeze(1)
            optimiser.zero_grad()
            F.binary_cross_entropy_with_logits(told, wanted[part]).backward()
            optimiser.step()
    net.eval()
    with torch.inference_mode():
        right = (net(given[held]).squeeze(1) > 0) == (wanted[held] > 0.5)
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
