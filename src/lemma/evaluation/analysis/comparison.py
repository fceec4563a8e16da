"""Paired comparison of two results on the same episodes."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lemma.core.errors import DatasetError
from lemma.evaluation.analysis.rates import wilson_interval
from lemma.evaluation.lines import lines_at, read_lines
from lemma.evaluation.protocol.rules import check_protocol
from lemma.evaluation.records import EpisodeKey, Row, key_of, read_about
from lemma.tasks.language.template import ALL_KINDS
from lemma.tasks.names import in_order

_SAME = ("split", "lemma")
"""Fields that determine the episodes and the simulation, not the policy."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Success of two policies on the same episodes."""

    episodes: int
    success_rates: tuple[float, float]
    """Of the first and of the second."""
    both: int
    """Episodes that both solved."""
    only_first: int
    only_second: int
    neither: int
    difference: float
    """First rate minus second."""
    interval: tuple[float, float]
    """95 % interval of the difference (Newcombe, paired)."""
    p_value: float
    """The p-value of McNemar's exact test, for the hypothesis of equal success
    rates."""


@dataclass(frozen=True)
class Comparisons:
    """Two results on the episodes that both have."""

    by_kind: dict[str, dict[str, Comparison]]
    """By kind of instructions, and then by task and for ``"all"``, with strict success;
    ``"lenient"`` is all episodes with lenient success, if both results have it."""
    common: int
    """Number of common episodes."""
    unpaired: tuple[int, int]
    """Numbers of episodes of the first alone and of the second alone."""


def compare(first: Path, second: Path) -> Comparisons:
    """Compare two results on the episodes that both have.

    Args:
        first: Folder that ``lemma evaluate`` wrote; or the file of a result with lines
            beside it, or packed lines; see :func:`lemma.evaluation.lines.lines_at`.
        second: The other.

    Raises:
        DatasetError: One is missing, they have no episode in common, or they are
            of other versions.
    """
    places = lines_at(first), lines_at(second)
    mine, others = map(_rows, (first, second), places)
    about, other = map(read_about, places)
    check_protocol(about, other, first, second)
    for name in _SAME:
        if about.get(name) != other.get(name):
            raise DatasetError(
                f"{first} was made with {name} {about.get(name)}, and {second} with "
                f"{other.get(name)}: what differs may not be the policy. Evaluate one "
                "of them again."
            )
    pairs = {name: (row, others[name]) for name, row in mine.items() if name in others}
    if not pairs:
        raise DatasetError(
            f"{first} and {second} have no episode in common. Evaluate one of them "
            "with the --instructions, --tasks and --split of the other."
        )
    found: dict[str, dict[str, Comparison]] = {}
    for kind in ALL_KINDS:
        of_kind = {name: pair for name, pair in pairs.items() if name[0] == kind}
        if of_kind:
            groups = {"all": list(of_kind.values())}
            for task in in_order(name[1] for name in of_kind):
                groups[task] = [
                    pair for name, pair in of_kind.items() if name[1] == task
                ]
            later = [(one["lenient"], two["lenient"]) for one, two in of_kind.values()]
            if all(one and two for one, two in later):
                groups["lenient"] = later
            found[kind] = {name: _count(group) for name, group in groups.items()}
    unpaired = len(mine) - len(pairs), len(others) - len(pairs)
    return Comparisons(found, len(pairs), unpaired)


def _count(pairs: Iterable[tuple[Row, Row]]) -> Comparison:
    solved = Counter((bool(one["success"]), bool(two["success"])) for one, two in pairs)
    episodes = solved.total()
    both, neither = solved[True, True], solved[False, False]
    only_first, only_second = solved[True, False], solved[False, True]
    return Comparison(
        episodes,
        ((both + only_first) / episodes, (both + only_second) / episodes),
        *(both, only_first, only_second, neither),
        difference=(only_first - only_second) / episodes,
        interval=paired_interval(both, only_first, only_second, neither),
        p_value=mcnemar_p(only_first, only_second),
    )


def _rows(path: Path, lines: Path) -> dict[EpisodeKey, Row]:
    rows = read_lines(lines)
    if not rows:
        raise DatasetError(
            f"There are no episodes in {path} yet. The command that writes them goes "
            "on where it was stopped."
        )
    return {key_of(row): row for row in rows}


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

    It combines the Wilson intervals of the two rates by their correlation (Newcombe
    1998, method 10), so it stays within [-1, 1] and is valid for small numbers.

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
