"""Requests of planners to language models, counted from the lines of episodes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from lemma.evaluation.records import Row


@dataclass(frozen=True, slots=True)
class Planning:
    """Sums over the strict episodes of one kind of instructions and one task.

    Whether the robots were well chosen stands in
    :class:`~lemma.evaluation.analysis.coordination.Coordination`.
    """

    kind: str
    task: str
    episodes: int
    decisions: int
    """Sub-tasks, ``stop``, and decisions that no answer came to."""
    calls: int
    """Requests to the model."""
    prompt_tokens: int
    completion_tokens: int
    invalid: dict[str, int]
    """Answers that were no sub-task, by kind."""
    replans: int
    """Decisions after a sub-task that was not carried out."""


def planning_in(rows: Sequence[Row], kind: str, task: str) -> Planning | None:
    """Sum what episodes of one kind and task took; None where nobody counted it."""
    told = [row["planning"] for row in rows if row.get("planning")]
    if not told:
        return None
    invalid: Counter[str] = Counter()
    for each in told:
        invalid.update(each["invalid"])
    counted = ("decisions", "calls", "prompt_tokens", "completion_tokens", "replans")
    sums = {name: sum(each[name] for each in told) for name in counted}
    return Planning(
        kind, task, len(rows), invalid=dict(sorted(invalid.items())), **sums
    )
