"""Measure how well meta-information predicts tasks and robots, without images.

    python scripts/measure_meta_information.py [SPLITS]

A small network is trained on meta-information: the arms, the poses of their bases, and
the numbers of cubes and pads. It predicts the first robot of the expert's plan, and the
task among those with the same form of sentence. The accuracies are from ten-fold
cross-validation over the frozen lists.
"""

import sys
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.scene.objects.entity import kind_of
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, load_instance

FOLDS = 10
SAME_SENTENCE = (("pass", "poke", "hook"), ("stack", "poke_stack", "hook_stack"))
"""Tasks whose sentences have the same form."""
_EPOCHS, _WIDTH = 150, 32


def meta_information(instance: Instance) -> list[float]:
    """Return the features of an instance that need no image."""
    robots = instance.scene.robots
    kinds = [placed.kind for placed in instance.scene.objects]
    return [
        *(float(robot.arm == "ur10") for robot in robots),
        *(x for r in robots for x in (r.base.x, r.base.y, r.base.yaw)),
        *(float(kinds.count(kind)) for kind in ("cube", "pad")),
    ]


def first_robot(instance: Instance) -> int:
    """Return the number of the first robot in the expert's plan."""
    spec = instance.scene
    movable = [o.name for o in spec.objects if not o.entity.kind.fixed]
    state = SymbolicState(
        spec,
        {placed.name: placed.pose for placed in spec.objects},
        {name: TABLE for name in movable if kind_of(name).cargo},
        dict.fromkeys(movable, "start"),
    )
    plan = find_plan(state, instance.goal, GeometricGrounder(spec))
    if plan is None:
        raise ValueError(f"There is no plan for {instance.key}.")
    return spec.robot_names.index(plan.subtasks[0].robot)


def share_right(features: Sequence[Sequence[float]], labels: Sequence[int]) -> float:
    """Return the accuracy in cross-validation, in [0, 1]."""
    x = torch.tensor(features, dtype=torch.float32)
    x = (x - x.mean(0)) / x.std(0).clamp(min=1e-6)
    y = torch.tensor(labels)
    fold = torch.from_numpy(np.random.default_rng(0).permutation(len(y)) % FOLDS)
    right = 0
    for held in range(FOLDS):
        torch.manual_seed(held)
        model = nn.Sequential(
            nn.Linear(x.shape[1], _WIDTH),
            nn.ReLU(),
            nn.Linear(_WIDTH, int(y.max()) + 1),
        )
        optimizer = torch.optim.AdamW(model.parameters(), lr=0.01, weight_decay=0.1)
        for _ in range(_EPOCHS):
            optimizer.zero_grad()
            loss = nn.functional.cross_entropy(model(x[fold != held]), y[fold != held])
            loss.backward()
            optimizer.step()
        with torch.no_grad():
            right += int((model(x[fold == held]).argmax(1) == y[fold == held]).sum())
    return right / len(y)


def instances(task: str, splits: Sequence[str] = tuple(SPLITS)) -> list[Instance]:
    """Return the frozen instances of a task."""
    return [load_instance(task, s, i) for s in splits for i in range(SPLITS[s])]


def main() -> None:
    """Print both accuracies for every task."""
    splits = sys.argv[1].split(",") if len(sys.argv) > 1 else tuple(SPLITS)
    listed = {task: instances(task, splits) for task in SUITE}
    features = {task: [meta_information(i) for i in listed[task]] for task in SUITE}
    for task in SUITE:
        share = share_right(features[task], [first_robot(i) for i in listed[task]])
        print(f"{task}: who acts first, {share:.1%} right (1/2 by chance)", flush=True)
    for tasks in SAME_SENTENCE:
        labels = [tasks.index(task) for task in tasks for _ in listed[task]]
        share = share_right([row for task in tasks for row in features[task]], labels)
        print(f"{', '.join(tasks)}: which task, {share:.1%} right (1/3 by chance)")


if __name__ == "__main__":
    main()
