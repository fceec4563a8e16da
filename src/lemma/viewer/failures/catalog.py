"""Failed episodes of results, and filters for them."""

from collections.abc import Sequence
from dataclasses import dataclass

from lemma.core.errors import InvalidConfigError
from lemma.evaluation.records import EPISODES, PACKED
from lemma.evaluation.report.episodes import Case

ALL = "all"
"""Any policy, task or cause."""


def words(name: str) -> str:
    """Return a cause in words."""
    return name.replace("_", " ")


@dataclass(frozen=True)
class Filter:
    """Conditions on an episode."""

    policy: str = ALL
    task: str = ALL
    cause: str = ALL
    """In words."""

    def takes(self, case: Case) -> bool:
        """Whether an episode failed and meets the conditions."""
        return (
            case.cause is not None
            and self.policy in (ALL, case.policy)
            and self.task in (ALL, case.row["task"])
            and self.cause in (ALL, words(case.cause))
        )


class Catalog:
    """Episodes of results, and what can be chosen among those that failed."""

    def __init__(self, cases: Sequence[Case]) -> None:
        """Keep them.

        Raises:
            InvalidConfigError: There are none, or none of them failed.
        """
        self.cases = tuple(cases)
        if not cases:
            raise InvalidConfigError(
                "No lines of episodes lie beside these results: there must be the "
                f"{EPISODES} that 'lemma evaluate' wrote with them, or the "
                f"NAME{PACKED} of 'lemma reproduce'."
            )
        failed = self.find(Filter())
        if not failed:
            raise InvalidConfigError(
                f"None of the {len(self.cases)} episodes failed whose lines are there."
            )
        self.policies = (ALL, *dict.fromkeys(case.policy for case in failed))
        self.tasks = (ALL, *dict.fromkeys(case.row["task"] for case in failed))
        causes = sorted({words(case.cause) for case in failed if case.cause})
        self.causes = (ALL, *causes)

    def find(self, wanted: Filter) -> list[Case]:
        """Return the failures that pass a filter, in order."""
        return [case for case in self.cases if wanted.takes(case)]

    def others(self, case: Case) -> dict[str, Case]:
        """Return other policies' episodes of the same instance, by policy."""
        same = _start(case)
        return {
            other.policy: other
            for other in self.cases
            if other.policy != case.policy and _start(other) == same
        }


def title(case: Case) -> str:
    """Return the name of an episode in lists: ``"stack 12, unseen, reachnet"``."""
    row = case.row
    return (
        f"{row['task']} {row['index']}, {words(row['instruction_kind'])}, {case.policy}"
    )


def _start(case: Case) -> tuple[object, ...]:
    row = case.row
    moved = row.get("perturb_start", False)
    kind, about = row["instruction_kind"], case.about
    return row["task"], row["split"], row["index"], kind, moved, about["language"]
