"""Two results on the same episodes, compared episode by episode."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lemma.core.errors import DatasetError
from lemma.evaluation.analysis.intervals import mcnemar_p, paired_interval
from lemma.evaluation.lines import lines_at, read_lines
from lemma.evaluation.protocol.rules import check_protocol
from lemma.evaluation.records import EpisodeKey, Row, key_of, read_about
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.names import in_order

_SAME = ("split", "lemma")
"""Fields that decide the episodes and the world, and not the policy."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """How two policies did on the same episodes."""

    both: int
    """Episodes that both solved."""
    only_first: int
    only_second: int
    neither: int

    @property
    def episodes(self) -> int:
        """How many there are."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def rates(self) -> tuple[float, float]:
        """Success rates of the first and of the second."""
        first, second = self.both + self.only_first, self.both + self.only_second
        return first / self.episodes, second / self.episodes

    @property
    def difference(self) -> float:
        """First rate minus second."""
        return (self.only_first - self.only_second) / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the difference (Newcombe, paired)."""
        return paired_interval(
            self.both, self.only_first, self.only_second, self.neither
        )

    @property
    def p_value(self) -> float:
        """The p-value of McNemar's exact test that both are as good."""
        return mcnemar_p(self.only_first, self.only_second)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            "episodes": self.episodes,
            "success_rates": self.rates,
            "both": self.both,
            "only_first": self.only_first,
            "only_second": self.only_second,
            "neither": self.neither,
            "difference": self.difference,
            "interval": self.interval,
            "p_value": self.p_value,
        }


@dataclass(frozen=True)
class Comparisons:
    """Two results on the episodes that both have."""

    by_kind: dict[str, dict[str, Comparison]]
    """By kind of instructions, and then for ``"all"`` and by task, all strictly; and
    for ``"lenient"``, all episodes once more, where both were played so."""
    common: int
    """How many episodes both have."""
    unpaired: tuple[int, int]
    """How many only the first has, and only the second."""


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
    _check_same_world((first, second), places)
    pairs = {name: (row, others[name]) for name, row in mine.items() if name in others}
    if not pairs:
        raise DatasetError(
            f"{first} and {second} have no episode in common. Evaluate one of them "
            "with the --instructions, --tasks and --split of the other."
        )
    found: dict[str, dict[str, Comparison]] = {}
    for kind in EVALUATION_KINDS:
        of_kind = {name: pair for name, pair in pairs.items() if name[0] == kind}
        if of_kind:
            found[kind] = {"all": _count(of_kind.values())}
            for task in in_order(name[1] for name in of_kind):
                of_task = [pair for name, pair in of_kind.items() if name[1] == task]
                found[kind][task] = _count(of_task)
            later = [(one["lenient"], two["lenient"]) for one, two in of_kind.values()]
            if all(one and two for one, two in later):
                found[kind]["lenient"] = _count(later)
    unpaired = len(mine) - len(pairs), len(others) - len(pairs)
    return Comparisons(found, len(pairs), unpaired)


def _count(pairs: Iterable[tuple[Row, Row]]) -> Comparison:
    listed = [(bool(one["success"]), bool(two["success"])) for one, two in pairs]
    return Comparison(
        both=listed.count((True, True)),
        only_first=listed.count((True, False)),
        only_second=listed.count((False, True)),
        neither=listed.count((False, False)),
    )


def _rows(path: Path, lines: Path) -> dict[EpisodeKey, Row]:
    rows = read_lines(lines)
    if not rows:
        raise DatasetError(
            f"There are no episodes in {path} yet. The command that writes them goes "
            "on where it was stopped."
        )
    return {key_of(row): row for row in rows}


def _check_same_world(paths: Sequence[Path], places: Sequence[Path]) -> None:
    first, second = paths
    abouts = [read_about(lines) for lines in places]
    check_protocol(abouts[0], abouts[1], first, second)
    for name in _SAME:
        values = [about.get(name) for about in abouts]
        if values[0] != values[1]:
            raise DatasetError(
                f"{first} was made with {name} {values[0]}, and {second} with "
                f"{values[1]}: what differs may not be the policy. Evaluate one of "
                "them again."
            )
