"""All tables of the paper (arXiv 2308.00937, on Isaac Sim).

Success rates [%] on its test split, mean ± standard deviation over ten runs of the same
weights, whose physics and rendering are not deterministic. The robots' names, tasks and
kinds of instructions are ours.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from lemma.tasks.suite import SUITE

TEAMS = ("ur5+ur5", "ur5+ur10", "ur10+ur10")
DISTRACTORS = (0, 1, 2)


@dataclass(frozen=True, slots=True)
class Measured:
    """One figure of the paper [%]."""

    mean: float
    std: float

    def __str__(self) -> str:
        """Return it as it is printed there."""
        return f"{self.mean:.2f} ± {self.std:.2f}"


@dataclass(frozen=True)
class Figures:
    """Figures of the paper for one policy and kind of instructions."""

    mean: Measured
    """Mean over the eight tasks."""
    tasks: Mapping[str, Measured]
    """By task."""
    teams: Mapping[str, Measured] = field(default_factory=dict)
    """By types of the robots."""
    distractors: Mapping[str, Mapping[int, Measured]] = field(default_factory=dict)
    """By task and number of distractors."""

    def of(
        self, task: str = "", team: str = "", distractors: int | None = None
    ) -> Measured | None:
        """Return the figure of some episodes, if the paper has it; else of all."""
        if distractors is not None:
            return self.distractors.get(task, {}).get(distractors)
        if team:
            return self.teams.get(team)
        return self.tasks.get(task) if task else self.mean


def _measured(text: str) -> list[Measured]:
    """Return figures as they are printed: ``"34.33±2.19 0.00±0.00"``."""
    pairs = (word.split("±") for word in text.split())
    return [Measured(float(mean), float(std)) for mean, std in pairs]


def _figures(text: str, teams: str = "", **distractors: str) -> Figures:
    """Return a row: the eight tasks and their mean, then what else there is of it."""
    *tasks, mean = _measured(text)
    return Figures(
        mean,
        dict(zip(SUITE, tasks, strict=True)),
        dict(zip(TEAMS, _measured(teams), strict=True)) if teams else {},
        {
            task: dict(zip(DISTRACTORS, _measured(row), strict=True))
            for task, row in distractors.items()
        },
    )


M_CLIPORT = {
    "high_level": _figures(
        "34.33±2.19 0.00±0.00 10.67±0.82 0.00±0.00 15.33±4.64 6.00±0.82 21.67±4.34 "
        "1.67±1.50 11.21±0.76",
        teams="13.50±0.84 11.27±0.51 9.10±2.23",
    ),
    "human": _figures(
        "25.83±1.86 0.00±0.00 20.00±2.36 0.00±0.00 4.58±1.38 1.25±1.38 3.75±0.72 "
        "0.00±0.00 6.93±0.47",
        teams="6.62±0.93 8.52±1.25 4.48±1.06",
    ),
}
SINGLE_STEP = {
    "high_level": _figures(
        "87.00±0.67 27.00±1.25 41.67±0.00 30.00±3.86 28.00±3.86 10.33±1.24 86.70±2.36 "
        "35.00±2.36 43.21±0.45",
        teams="37.44±1.00 41.05±1.30 51.94±1.17",
        **{"pass": "91.67±0.00 87.06±2.35 81.18±3.50"},
        stack="46.15±0.00 40.00±3.08 16.92±2.86",
        poke="33.08±7.14 30.00±4.44 17.50±2.50",
        hook="91.30±3.89 83.16±3.94 84.44±7.37",
    ),
    "human": _figures(
        "44.44±2.29 1.67±0.00 21.67±1.36 0.00±0.00 13.88±1.24 2.50±0.83 25.56±1.57 "
        "9.17±1.60 14.86±0.26",
        teams="16.81±0.40 15.57±0.33 11.94±0.96",
        **{"pass": "75.00±0.00 53.92±2.19 37.25±5.55"},
        stack="16.67±2.87 28.33±2.36 15.38±6.28",
        poke="16.03±2.64 12.96±2.62 11.46±6.67",
        hook="26.09±2.51 32.46±3.62 17.59±2.07",
    ),
}
SINGLE_STEP_GTA = {
    "high_level": _figures(
        "100.00±0.00 84.67±2.67 91.33±0.67 72.00±0.67 46.67±0.00 32.33±1.70 98.33±0.11 "
        "73.33±2.36 74.83±0.44"
    ),
    "human": _figures(
        "63.33±0.00 5.56±1.24 59.44±1.24 1.39±0.62 25.28±0.62 9.17±1.27 30.00±0.00 "
        "19.72±0.62 26.74±0.20"
    ),
}
MULTI_STEP = {
    "high_level": _figures(
        "83.06±1.15 28.06±1.78 28.89±0.79 31.11±2.48 30.83±2.31 9.17±1.27 82.78±1.57 "
        "24.72±4.66 39.83±0.84",
        teams="38.60±3.25 36.32±0.47 46.89±1.69",
    ),
    "human": _figures(
        "58.33±1.18 0.00±0.00 38.54±0.99 0.00±0.00 7.71±2.92 2.92±1.10 21.46±0.99 "
        "3.96±1.16 16.61±0.39",
        teams="15.71±0.59 19.16±0.83 13.06±0.53",
    ),
}
MULTI_STEP_GTA = {
    "high_level": _figures(
        "100.00±0.00 83.89±3.00 90.00±0.00 74.72±1.78 55.28±0.62 35.56±1.24 96.94±0.62 "
        "58.34±1.93 74.34±0.56"
    ),
    "human": _figures(
        "81.89±0.55 5.00±1.44 70.42±0.72 0.00±0.00 15.00±0.00 8.33±1.67 23.33±0.00 "
        "14.17±1.87 27.27±0.30"
    ),
}
"""By kind of instructions."""
