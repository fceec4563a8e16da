"""Pairs of a feasible and an infeasible instance: solve the one, refuse the other.

A policy refuses if its first decision is to stop, with an explanation of what is out of
whose reach. The rules are those of other episodes.
"""

from typing import Any

from lemma.evaluation.run.rollout import Rollout
from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.tasks.teams.pairs import PAIRS, lack_in

_LONGEST = 500


def pair_fields(rollout: Rollout) -> dict[str, Any]:
    """Return what the line of an instance of a pair says of a refusal.

    Args:
        rollout: The episode, which is over; nothing is said of other splits.
    """
    instance, reason = rollout.instance, rollout.refusal
    if instance.split != PAIRS:
        return {}
    return {
        "pair": {
            "can": lack_in(instance.index) is None,
            "refused": reason is not None,
            "explained": _explains(reason or "", instance),
            "reason": (reason or "")[:_LONGEST],
        }
    }


def _explains(reason: str, instance: Instance) -> bool:
    """Whether a reason names what is lacking alone."""
    lack = lack_in(instance.index)
    said = reason[:_LONGEST]
    named = {n for n in instance.goal.entities if entity_named(n).phrase in said}
    return lack is not None and named == {*lack.things}
