"""What an audit found, summed up by attack and task."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from lemma.audit.run import Found


@dataclass(frozen=True, slots=True)
class Tally:
    """What one attack did to the instances of one task."""

    level: str
    tried: int
    """Instances, each with every robot."""
    executed: int
    """Those in which something was executed; in the others geometry gave it up."""
    succeeded: int
    """Instances that were solved."""
    best_progress: float
    """Most of a goal that ever held, in [0, 1]."""


def tally(found: Iterable[Found]) -> dict[str, dict[str, Tally]]:
    """Return sums by attack and task, in the order in which they come."""
    tallies: dict[str, dict[str, Tally]] = {}
    for one in found:
        of_tasks = tallies.setdefault(one.attack, {})
        so_far = of_tasks.get(one.task, Tally(one.level, 0, 0, 0, 0.0))
        of_tasks[one.task] = Tally(
            one.level,
            so_far.tried + 1,
            so_far.executed + one.acted,
            so_far.succeeded + one.succeeded,
            max(so_far.best_progress, one.progress),
        )
    return tallies


def to_dict(tallies: dict[str, dict[str, Tally]]) -> dict[str, Any]:
    """Return sums as plain data, ready for JSON: without what was executed."""
    return {
        "attacks": {
            attack: {
                task: {
                    "level": sums.level,
                    "tried": sums.tried,
                    "succeeded": sums.succeeded,
                    "best_progress": sums.best_progress,
                }
                for task, sums in of_tasks.items()
            }
            for attack, of_tasks in tallies.items()
        }
    }
