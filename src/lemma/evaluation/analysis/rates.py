"""Counts of episodes, and rates of success with their intervals."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from statistics import fmean


@dataclass(frozen=True, slots=True)
class Cell:
    """Episodes of one kind, task, team and number of distractors."""

    kind: str
    """Kind of instruction."""
    task: str
    team: str
    distractors: int
    episodes: int
    successes: int
    """Strict successes: no robot was sent to an infeasible sub-task."""
    lenient_successes: int | None
    """Successes including play after a protective stop; None if that was not played."""
    progress: float
    """Sum over the episodes of the progress at the end."""


@cache
def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a success rate.

    Args:
        successes: Number of successes among the trials.
        trials: At least one.

    Raises:
        ValueError: No trials, or more successes than trials.
    """
    # Import late: it takes 0.65 s, which commands without statistics save.
    from scipy.stats import binomtest  # noqa: PLC0415

    found = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


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
    """Return the success rate over the episodes of one or more cells."""
    listed = list(cells)
    episodes = sum(cell.episodes for cell in listed)
    return Rate(
        episodes,
        sum(cell.successes for cell in listed),
        math.fsum(cell.progress for cell in listed) / episodes,
    )


def rates_by(cells: Iterable[Cell], *columns: str) -> dict[tuple[str, ...], Rate]:
    """Return the success rate for every combination of values, in order of appearance.

    Args:
        cells: Counted episodes.
        columns: Fields to group by, such as ``"kind", "task"``.
    """
    groups: dict[tuple[str, ...], list[Cell]] = {}
    for cell in cells:
        name = tuple(str(getattr(cell, column)) for column in columns)
        groups.setdefault(name, []).append(cell)
    return {name: rate_of(listed) for name, listed in groups.items()}


def leniently(cells: Iterable[Cell]) -> list[Cell]:
    """Return cells with lenient successes; an empty list if a cell has none."""
    found = []
    for cell in cells:
        if cell.lenient_successes is None:
            return []
        found.append(replace(cell, successes=cell.lenient_successes))
    return found


def mean_over_tasks(cells: Iterable[Cell]) -> float:
    """Return the unweighted mean of the tasks' success rates."""
    return fmean(rate.success_rate for rate in rates_by(cells, "task").values())


def rates_in_words(cells: Iterable[Cell]) -> dict[tuple[str, str], str]:
    """Return the counts of successes as text, by kind and task."""
    won: Counter[tuple[str, str]] = Counter()
    played: Counter[tuple[str, str]] = Counter()
    for cell in cells:
        won[cell.kind, cell.task] += cell.successes
        played[cell.kind, cell.task] += cell.episodes
    return {name: f"{won[name]} of {played[name]}" for name in played}
