"""Rates of success, made from counts and from nothing else."""

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import fmean

from lemma.evaluation.result import Cell
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


def rate_of(cells: Iterable[Cell]) -> Rate:
    """Return the success in all episodes of some cells; at least one."""
    listed = list(cells)
    episodes = sum(cell.episodes for cell in listed)
    return Rate(
        episodes,
        sum(cell.successes for cell in listed),
        sum(cell.progress for cell in listed) / episodes,
    )


def rates_by(cells: Iterable[Cell], *columns: str) -> dict[tuple[str, ...], Rate]:
    """Return the success for every combination of values, in order of appearance.

    Args:
        cells: Counted episodes.
        columns: Fields to group by, such as ``"kind", "task"``.
    """
    groups: dict[tuple[str, ...], list[Cell]] = {}
    for cell in cells:
        name = tuple(str(getattr(cell, column)) for column in columns)
        groups.setdefault(name, []).append(cell)
    return {name: rate_of(listed) for name, listed in groups.items()}


def mean_over_tasks(cells: Iterable[Cell]) -> float:
    """Return the mean of the tasks' success rates, each counting the same."""
    return fmean(rate.success_rate for rate in rates_by(cells, "task").values())
