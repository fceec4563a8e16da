"""Measure how often the parts of a planner's first decision equal the expert's.

    python scripts/measure_first_decisions.py episodic-transformer pass stack poke hook

The planner gets the first view of each instance of the validation split, with its
high-level instruction.
"""

import argparse
from collections import Counter

import torch

from lemma.env.camera_rig import CameraRig
from lemma.evaluation.run.rollout import Rollout
from lemma.expert.expert import Expert
from lemma.policies.interfaces import Planner
from lemma.policies.weights import load_model
from lemma.tasks.suite import load_instance

PARTS = ("robot", "primitive", "pick", "place")
INSTANCES = 40


def main() -> None:
    """Measure, and print the shares by task."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weights")
    parser.add_argument("tasks", nargs="+")
    options = parser.parse_args()
    torch.set_num_threads(1)
    planner = load_model(options.weights)
    assert isinstance(planner, Planner)
    rig = CameraRig()
    for task in options.tasks:
        right: Counter[str] = Counter()
        for index in range(INSTANCES):
            instance = load_instance(task, "val", index)
            rollout = Rollout(instance)
            scene = rollout.episode.simulation.scene
            want, _ = Expert(scene, instance.goal).act()
            (got,) = planner.plan([rollout.policy_input(rig)])
            for part in PARTS:
                right[part] += getattr(got, part) == getattr(want, part)
        shares = (f"{part} {right[part] / INSTANCES:.1%}" for part in PARTS)
        print(f"{task}:", *shares, flush=True)


if __name__ == "__main__":
    main()
