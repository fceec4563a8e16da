"""Random orders for training: a goal as tasks have them, and a sentence for it."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from lemma.policies.text.paraphrase import one_of, paraphrase
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.tasks.language.bank import templates
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.suite import SUITE


def draw_order(rng: np.random.Generator) -> tuple[str, GoalPairs]:
    """Return a paraphrased instruction of some task, and its goal."""
    task = one_of(SUITE, rng)
    goal = draw_goal(pair_kinds(task), rng)
    return paraphrase(task, goal, rng), goal


@cache
def pair_kinds(task: str) -> tuple[tuple[str, str], ...]:
    """Return the kinds of the (top, bottom) pairs of a task's goal."""
    found = templates(task, "high_level")[0].entity_kinds
    assert found is not None
    return found


def draw_goal(kinds: Sequence[tuple[str, str]], rng: np.random.Generator) -> GoalPairs:
    """Return a goal with pairs of some kinds, in which no entity occurs twice."""
    count = len(BENCHMARK_COLORS)
    left = {kind: rng.permutation(count).tolist() for kind in ("cube", "pad")}

    def one(kind: str) -> str:
        return f"{BENCHMARK_COLORS[left[kind].pop()]}_{kind}"

    return tuple((one(top), one(bottom)) for top, bottom in kinds)
