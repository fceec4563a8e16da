"""Tables of success rates, made from the lines of episodes and from nothing else."""

from collections.abc import Iterable
from dataclasses import dataclass

from lemma.evaluation.evaluate import Row
from lemma.evaluation.statistics import wilson_interval


@dataclass(frozen=True, slots=True)
class Rate:
    """Success in some episodes."""

    episodes: int
    successes: int
    progress: float
    """Mean fraction of the goal that holds at the end."""

    @property
    def success_rate(self) -> float:
        """Successes per episode."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success rate."""
        return wilson_interval(self.successes, self.episodes)


def rate_of(rows: Iterable[Row]) -> Rate:
    """Return the success in episodes; at least one."""
    listed = list(rows)
    return Rate(
        len(listed),
        sum(bool(row["success"]) for row in listed),
        sum(row["progress"] for row in listed) / len(listed),
    )


def rates_by(rows: Iterable[Row], *columns: str) -> dict[tuple[str, ...], Rate]:
    """Return the success for every combination of values, in order of appearance.

    Args:
        rows: Episodes.
        columns: What to group by, such as ``"instruction_kind", "task"``.
    """
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(str(row[name]) for name in columns), []).append(row)
    return {name: rate_of(listed) for name, listed in groups.items()}
