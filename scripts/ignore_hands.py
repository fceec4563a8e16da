"""Print how often a plan by reach alone gives a weak hand the heavy cube of `strong`.

    python scripts/ignore_hands.py [SPLIT ...]

The splits are `val` and `train` unless named. Only plans are made, nothing is executed.
"""

import sys
from dataclasses import replace

from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.hand import STANDARD
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance, splits_of
from lemma.tasks.suite import load_instance

TASK = "strong"


def plan_overloads(instance: Instance) -> bool:
    """Whether the plan for strong hands alone gives a hand what it cannot carry."""
    alike = tuple(replace(robot, hand=STANDARD) for robot in instance.scene.robots)
    spec = replace(instance.scene, robots=alike)
    start = SymbolicState.observe(Scene(spec))
    plan = find_plan(start, instance.goal, GeometricGrounder(spec))
    assert plan is not None
    hands = GeometricGrounder(instance.scene)
    return any(hands.overload(step.robot, step.pick) for step in plan.subtasks)


if __name__ == "__main__":
    for split in sys.argv[1:] or ("val", "train"):
        count = splits_of(TASK)[split]
        tables = (load_instance(TASK, split, index) for index in range(count))
        found = sum(map(plan_overloads, tables))
        print(f"{split}: overloaded in {found} of {count}")
