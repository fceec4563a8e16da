"""Whether the frozen lists draw evenly what they should: chi-square tests together."""

from collections import Counter
from collections.abc import Callable

from scipy.stats import chisquare

from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, load_instance

FALSE_ALARMS = 0.01
DRAWS: dict[str, tuple[int, Callable[[Instance], str]]] = {
    "team": (3, lambda instance: instance.team),
    "left robot": (2, lambda instance: instance.scene.robots[0].color),
    "right robot": (2, lambda instance: instance.scene.robots[1].color),
    "top of the goal": (5, lambda instance: instance.goal.pairs[0][0]),
    "what is below it": (5, lambda instance: instance.goal.pairs[0][1]),
}
"""How many values there are, and which an instance drew: one draw per instance, so
that draws are independent, as the test wants."""


def test_the_frozen_lists_are_balanced() -> None:
    p_values = {}
    for task in SUITE:
        instances = [
            load_instance(task, split, index)
            for split, count in SPLITS.items()
            for index in range(count)
        ]
        assert len(instances) == 800
        for name, (values, of) in DRAWS.items():
            counts = Counter(map(of, instances))
            assert len(counts) == values, (task, name, counts)
            p_values[task, name] = chisquare(list(counts.values())).pvalue
    # Bonferroni's bound: of lists that are drawn evenly, one in a hundred is worse.
    assert min(p_values.values()) >= FALSE_ALARMS / len(p_values), p_values
