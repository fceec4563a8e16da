"""Statistics of success: what a rate of so few episodes can say."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from statistics import fmean

from lemma.evaluation.analysis.result import Cell


@cache
def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a success rate.

    Args:
        successes: Number of successes among the trials.
        trials: At least one.

    Raises:
        ValueError: No trials, or more successes than trials.
    """
    # 0.65 s that a command without statistics does not spend.
    from scipy.stats import binomtest  # noqa: PLC0415

    found = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def mcnemar_p(only_first: int, only_second: int) -> float:
    """Return the exact two-sided p-value of McNemar's test.

    Args:
        only_first: Episodes that only the first policy solved.
        only_second: Episodes that only the second one solved.
    """
    # As in :func:`wilson_interval`.
    from scipy.stats import binomtest  # noqa: PLC0415

    discordant = only_first + only_second
    if discordant == 0:
        return 1.0
    return float(binomtest(only_first, discordant).pvalue)


def paired_interval(
    both: int, only_first: int, only_second: int, neither: int
) -> tuple[float, float]:
    """Return Newcombe's interval of the difference of two paired rates, first - second.

    It joins the Wilson intervals of the two rates by their correlation (Newcombe 1998,
    method 10), so it stays within [-1, 1] and holds for small numbers.

    Args:
        both: Episodes that both policies solved.
        only_first: Episodes that only the first one solved.
        only_second: Episodes that only the second one solved.
        neither: Episodes that none of them solved.

    Raises:
        ValueError: There are no episodes.
    """
    total = both + only_first + only_second + neither
    first, second = both + only_first, both + only_second
    rate_1, rate_2 = first / max(total, 1), second / max(total, 1)
    low_1, high_1 = wilson_interval(first, total)
    low_2, high_2 = wilson_interval(second, total)
    phi = _correlation(both, only_first, only_second, neither)
    below = _joined(rate_1 - low_1, high_2 - rate_2, phi)
    above = _joined(high_1 - rate_1, rate_2 - low_2, phi)
    difference = rate_1 - rate_2
    return difference - below, difference + above


def _joined(one: float, other: float, phi: float) -> float:
    return math.sqrt(max(0.0, one * one - 2.0 * phi * one * other + other * other))


def _correlation(both: int, only_first: int, only_second: int, neither: int) -> float:
    """Return phi, with Newcombe's correction for continuity where it is positive."""
    total = both + only_first + only_second + neither
    margins = (
        (both + only_first)
        * (only_second + neither)
        * (both + only_second)
        * (only_first + neither)
    )
    if margins == 0:
        return 0.0
    cross = float(both * neither - only_first * only_second)
    if cross > 0:
        cross = max(cross - total / 2.0, 0.0)
    return cross / math.sqrt(margins)


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
        math.fsum(cell.progress for cell in listed) / episodes,
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


def leniently(cells: Iterable[Cell]) -> list[Cell]:
    """Return cells whose successes are the lenient ones; none where one has none."""
    found = []
    for cell in cells:
        if cell.lenient_successes is None:
            return []
        found.append(replace(cell, successes=cell.lenient_successes))
    return found


def mean_over_tasks(cells: Iterable[Cell]) -> float:
    """Return the mean of the tasks' success rates, each counting the same."""
    return fmean(rate.success_rate for rate in rates_by(cells, "task").values())
