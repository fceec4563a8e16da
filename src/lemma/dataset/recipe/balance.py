"""Whether what should be drawn evenly was: chi-square tests, told as one verdict."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.special import chdtrc

from lemma.core.errors import InvalidConfigError
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import entity_named
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.pad import PAD
from lemma.scene.palette import BENCHMARK_COLORS
from lemma.scene.spec import ROBOT_COLORS
from lemma.tasks.instance import team_name
from lemma.tasks.task import TEAMS

TEAM_NAMES = tuple("+".join(team) for team in TEAMS)
ALL = "all"
"""In place of a name: all tasks together."""
LEAST_EXPECTED = 5
"""Of each value: with fewer, the chi-square test does not hold."""
_FALSE_ALARMS = 0.01


@dataclass(frozen=True, slots=True)
class Draw:
    """Something that every instance draws once, each value as likely as the others."""

    values: tuple[str, ...]
    of: Callable[[dict[str, Any]], str | None]
    """What an instance, as plain data, drew; None: it did not draw."""


def _goal_color(side: int, kind: ObjectKind) -> Callable[[dict[str, Any]], str | None]:
    def of(instance: dict[str, Any]) -> str | None:
        entity = entity_named(instance["goal"][0][side])
        drawn = entity.kind is kind and entity.color in BENCHMARK_COLORS
        return entity.color if drawn else None

    return of


def _team(instance: dict[str, Any]) -> str | None:
    team = team_name(robot[0] for robot in instance["robots"])
    return team if team in TEAM_NAMES else None


DRAWS = {
    "cube of the goal": Draw(BENCHMARK_COLORS, _goal_color(0, CUBE)),
    "pad below it": Draw(BENCHMARK_COLORS, _goal_color(1, PAD)),
    "cube below it": Draw(BENCHMARK_COLORS, _goal_color(1, CUBE)),
    "left robot": Draw(ROBOT_COLORS, lambda i: i["robots"][0][1]),
    "right robot": Draw(ROBOT_COLORS, lambda i: i["robots"][1][1]),
    "team": Draw(TEAM_NAMES, _team),
}
"""What is balanced by design. One draw per instance, so that draws are independent, as
the chi-square test wants; a goal's first pair stands for its others."""


def draws_of(instance: dict[str, Any]) -> dict[str, str]:
    """Return what an instance, as plain data, drew: see :data:`DRAWS`."""
    drawn = {name: draw.of(instance) for name, draw in DRAWS.items()}
    return {name: value for name, value in drawn.items() if value is not None}


@dataclass(frozen=True, slots=True)
class Balance:
    """How often each value was drawn, against all being as likely."""

    name: str
    counts: dict[str, int]
    p_value: float | None
    """Probability of counts at least this uneven, if all values are as likely. None
    where fewer than five of each value are expected: the test does not hold there."""


def balance(name: str, draws: Iterable[Mapping[str, str]]) -> Balance | None:
    """Test whether something was drawn evenly, by Pearson's chi-square test.

    Args:
        name: What was drawn, one of :data:`DRAWS`.
        draws: What every instance drew, see :func:`draws_of`.

    Returns:
        The result; None where nothing was drawn.
    """
    drawn = Counter(draw[name] for draw in draws if name in draw)
    if not drawn:
        return None
    counts = {value: drawn[value] for value in DRAWS[name].values}
    enough = drawn.total() >= LEAST_EXPECTED * len(counts)
    p_value = uniform_p_value(list(counts.values())) if enough else None
    return Balance(name, counts, p_value)


def balances_of(
    draws: Mapping[str, Sequence[Mapping[str, str]]],
) -> dict[str, dict[str, Balance]]:
    """Test everything that is balanced by design.

    Args:
        draws: By task: what every instance drew, see :func:`draws_of`.

    Returns:
        By what was drawn, and then for :data:`ALL` and by task.
    """
    groups = {ALL: [draw for group in draws.values() for draw in group], **draws}
    found: dict[str, dict[str, Balance]] = {}
    for name in DRAWS:
        for task, group in groups.items():
            if (tested := balance(name, group)) is not None:
                found.setdefault(name, {})[task] = tested
    return found


def uniform_p_value(counts: Sequence[int]) -> float:
    """Return the p-value of Pearson's chi-square test for equal probabilities.

    Raises:
        InvalidConfigError: Nothing was counted.
    """
    if not sum(counts):
        raise InvalidConfigError("Nothing was drawn, so there is nothing to test.")
    expected = sum(counts) / len(counts)
    statistic = sum((count - expected) ** 2 / expected for count in counts)
    return float(chdtrc(len(counts) - 1, statistic))


@dataclass(frozen=True, slots=True)
class Evenness:
    """What all tests for balance say together."""

    tests: int
    smallest_p: float | None
    """None if nothing could be tested."""
    limit: float
    """Smallest p-value that is still sampling noise: of recipes that are drawn evenly,
    one in a hundred has a smaller one (Bonferroni's bound)."""

    @property
    def even(self) -> bool:
        """Whether what was drawn differs from even by no more than sampling noise."""
        return self.smallest_p is None or self.smallest_p >= self.limit


def evenness(balances: Mapping[str, Mapping[str, Balance]]) -> Evenness:
    """Judge the results of :func:`balances_of` together.

    With dozens of tests, some p-values below 0.05 are to be expected.
    """
    found = [
        tested.p_value
        for group in balances.values()
        for tested in group.values()
        if tested.p_value is not None
    ]
    limit = _FALSE_ALARMS / max(len(found), 1)
    return Evenness(len(found), min(found, default=None), limit)
