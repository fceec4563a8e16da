"""Effort of planning: decisions, requests and invalid answers."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from lemma.evaluation.records import Row


@dataclass(frozen=True, slots=True)
class Planning:
    """Sums over the strict episodes of one kind of instructions and one task.

    For the choice of robots see
    :class:`~lemma.evaluation.analysis.coordination.Coordination`.
    """

    kind: str
    task: str
    episodes: int
    decisions: int
    """Number of sub-tasks, ``stop`` decisions, and decisions without an answer."""
    calls: int
    """Requests to the model."""
    prompt_tokens: int
    completion_tokens: int
    invalid: dict[str, int]
    """Invalid answers, by kind."""
    replans: int
    """Number of decisions after a sub-task that was not carried out."""


_EFFORT = ("decisions", "calls", "prompt_tokens", "completion_tokens", "replans")


def effort_of(rows: Sequence[Row], kind: str, task: str) -> Planning:
    """Sum the effort of the episodes of one kind and task.

    Args:
        rows: Lines of episodes; those whose policy did not count it add nothing.
        kind: Kind of instructions.
        task: Name of the task.
    """
    efforts = [row["planning"] for row in rows if row.get("planning")]
    invalid: Counter[str] = Counter()
    for each in efforts:
        invalid.update(each["invalid"])
    sums = {name: sum(each[name] for each in efforts) for name in _EFFORT}
    ordered = dict(sorted(invalid.items()))
    return Planning(kind, task, len(rows), invalid=ordered, **sums)
