"""Other wordings of rules than those of the templates, for training."""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files

import numpy as np

from lemma.scene.objects.entity import entity_named
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.teams.rule import But, Rule

WHOLE = "but_every"
"""Wordings of ``but`` that also say that all else goes to the pads of its color."""


@cache
def wordings() -> Mapping[str, Sequence[str]]:
    """Return the wordings by kind of rule, with slots, and :data:`WHOLE`."""
    source = files("lemma.policies.text") / "data" / "rules.toml"
    return tomllib.loads(source.read_text("utf-8"))


def say_rule_anew(
    rule: Rule,
    pairs: GoalPairs,
    goal: str,
    robots: Sequence[str],
    rng: np.random.Generator,
) -> str:
    """Draw a sentence that expresses a goal and its rule.

    Args:
        rule: The rule.
        pairs: The goal.
        goal: The sentence of the goal without the rule.
        robots: Phrases of the team.
        rng: Random generator.
    """
    found = [*wordings()[rule.kind]]
    if rule.kind == But.kind and _by_color(pairs):
        found += wordings()[WHOLE]
    chosen = found[int(rng.integers(len(found)))]
    return chosen.format(goal=goal.rstrip(".") + ".", **rule.words(robots))


def _by_color(pairs: GoalPairs) -> bool:
    both = [(entity_named(top), entity_named(bottom)) for top, bottom in pairs]
    return all(top.color == bottom.color != "" for top, bottom in both)
