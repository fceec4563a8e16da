"""Tables besides success: coordination of robots, and progress of episodes."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from lemma.core.tables import Table
from lemma.evaluation.analysis.coordination import Coordination
from lemma.evaluation.experiments.catalog import ABLATIONS
from lemma.evaluation.report.policy_results import NOTHING, PolicyResults
from lemma.tasks.language.template import ALL_KINDS
from lemma.tasks.names import LADDER

OfSeed = Callable[[Sequence[Coordination]], float | None]


@dataclass(frozen=True)
class Metric:
    """A column of the table of coordination."""

    name: str
    of_seed: OfSeed
    """Computes the value for one training seed; None if it is not defined."""
    places: int = 1
    """Number of decimal places."""
    over_seeds: Callable[[Sequence[float]], float] | None = None
    """Aggregates seeds; mean and standard deviation if None."""

    def shown(self, seeds: Sequence[Sequence[Coordination]]) -> str:
        """Return the text of a cell."""
        each = map(self.of_seed, seeds)
        values = [value for value in each if value is not None]
        if not values:
            return NOTHING
        text = f"{(self.over_seeds or fmean)(values):.{self.places}f}"
        if self.over_seeds is not None or len(values) == 1:
            return text
        return f"{text} ± {stdev(values):.{self.places}f}"


def _ratio(part: str, whole: str, scale: float = 100.0, robot: str = "") -> OfSeed:
    """Return a ratio of two summed fields; it is not defined if the whole is 0."""

    def of_seed(found: Sequence[Coordination]) -> float | None:
        below = math.fsum(getattr(one, whole) for one in found)
        parts = (getattr(one, part) for one in found)
        above = math.fsum(one.get(robot, 0.0) if robot else one for one in parts)
        return scale * above / below if below else None

    return of_seed


def _refusals(found: Sequence[Coordination]) -> float | None:
    played = all(one.refusals is not None for one in found)
    return _ratio("refusals", "episodes")(found) if played else None


def _violations(found: Sequence[Coordination]) -> float | None:
    told = any(one.judged for one in found)
    return _ratio("order_violations", "episodes")(found) if told else None


def _nearest(found: Sequence[Coordination]) -> float | None:
    gaps = [one.nearest_mm for one in found if one.nearest_mm is not None]
    return min(gaps, default=None)


METRICS = (
    Metric("time / expert's", _ratio("timed_s", "expert_s", 1.0), 2),
    Metric("idle, left [%]", _ratio("idle_s", "elapsed_s", robot="robot_0")),
    Metric("idle, right [%]", _ratio("idle_s", "elapsed_s", robot="robot_1")),
    Metric("first-try allocation [%]", _ratio("able", "doable")),
    Metric("expert's robot [%]", _ratio("as_expert", "planned")),
    Metric("order violations per 100", _violations),
    Metric("nearest arms [mm]", _nearest, 0, min),
    Metric("touching", lambda found: sum(one.touching for one in found), 0, sum),
    Metric("protective stops per 100", _ratio("stops", "episodes")),
    Metric("lenient: refusals per 100", _refusals),
    Metric(
        "lenient: time / expert's",
        _ratio("lenient_timed_s", "lenient_expert_s", 1.0),
        2,
    ),
)
"""Columns of the table of coordination."""


def coordination(entries: Iterable[PolicyResults], kind: str) -> Table:
    """Return the table of coordination, over all tasks.

    The measures are defined in :mod:`lemma.evaluation.analysis.coordination`.
    """
    rows = []
    for entry in entries:
        each = (
            [one for one in result.coordination if one.kind == kind]
            for result in entry.results
        )
        seeds = [found for found in each if found]
        if seeds and entry.suite != ABLATIONS:
            rows.append((entry.title, *(one.shown(seeds) for one in METRICS)))
    return Table(("", *(one.name for one in METRICS)), tuple(rows))


def reached(entries: Iterable[PolicyResults], *, by_task: bool = False) -> Table:
    """Return the table of progress and of the verdicts on first moves.

    It is over the strict episodes; :mod:`lemma.env.stages` defines both.

    Args:
        entries: Results by policy.
        by_task: Whether each task has a row, with high-level instructions, instead of
            each kind of instructions.
    """
    field = "task" if by_task else "kind"
    rows = []
    for entry in entries:
        every = [
            one
            for result in entry.results
            for one in result.reached
            if not by_task or one.kind == "high_level"
        ]
        values = LADDER if by_task else ALL_KINDS
        for value in values if entry.suite != ABLATIONS else ():
            found = [one for one in every if getattr(one, field) == value]
            if found:
                episodes = sum(one.episodes for one in found)
                shares = (
                    math.fsum(getattr(one, name) for one in found) / episodes
                    for name in _REACHED
                )
                cells = (f"{100 * share:.1f}" for share in shares)
                name = value if by_task else value.replace("_", "-")
                rows.append((entry.title, name, *cells))
    left = ("share [%]", "task") if by_task else ("all tasks [%]", "instructions")
    return Table((*left, *_REACHED.values()), tuple(rows), labels=2)


_REACHED = {
    "progress": "progress",
    "furthest": "furthest",
    "moved": "moved something",
    "understood": "understood",
    "allocated": "allocated",
    "executed": "executed",
}
"""Fields of a record, with the titles of their columns."""
