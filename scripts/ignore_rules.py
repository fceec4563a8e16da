"""Print how often the expert's plan keeps the rule of `exchange` by chance.

    python scripts/ignore_rules.py [SPLIT ...]

The plans are for the goals without their rules, and are not executed. The default
splits are `val` and `train`. Plans for *but* always keep its rule, because its
difficulty is in the words "every cube".
"""

import sys
from collections import Counter
from itertools import pairwise

from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance, splits_of
from lemma.tasks.suite import load_instance

TASK = "exchange"


def plan_keeps_rule(instance: Instance) -> bool:
    """Return whether the plan for the goal without its rule keeps the rule."""
    start = SymbolicState.observe(Scene(instance.scene))
    goal = Goal(instance.goal.conjuncts)
    plan = find_plan(start, goal, GeometricGrounder(instance.scene))
    assert plan is not None
    before = (one for one, _ in pairwise([start, *(s.after for s in plan.steps)]))
    steps = zip(plan.subtasks, before, strict=True)
    return all(instance.goal.permits(subtask, now.has) for subtask, now in steps)


if __name__ == "__main__":
    tables, kept = Counter[str](), Counter[str]()
    for split in sys.argv[1:] or ("val", "train"):
        for index in range(splits_of(TASK)[split]):
            instance = load_instance(TASK, split, index)
            assert instance.goal.rule is not None
            tables[instance.goal.rule.kind] += 1
            kept[instance.goal.rule.kind] += plan_keeps_rule(instance)
    for kind, count in tables.items():
        print(f"{kind}: kept in {kept[kind]} of {count}")
