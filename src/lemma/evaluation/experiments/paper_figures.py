"""What the paper reports (arXiv 2308.00937, on Isaac Sim), as far as we have it.

Means over the eight tasks are the paper's. Figures per task are worked back from rates
per sub-task that were kept to three digits, so they are given in whole per cent and are
good to about one. What we do not have is left out: all figures by number of distractors
and by team, among others.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from lemma.tasks.suite import SUITE


@dataclass(frozen=True)
class Figures:
    """Success rates [%] that the paper reports for one policy and kind."""

    mean: float | None = None
    """Over the eight tasks."""
    tasks: Mapping[str, int] = field(default_factory=dict)
    """By task, worked back; empty where we do not have them."""


def _by_task(*rates: int) -> dict[str, int]:
    return dict(zip(SUITE, rates, strict=True))


SINGLE_STEP = {
    "high_level": Figures(43.2, _by_task(87, 27, 42, 30, 28, 10, 87, 35)),
    "human": Figures(14.9, _by_task(44, 2, 22, 0, 14, 2, 26, 9)),
}
SINGLE_STEP_GTA = {
    "high_level": Figures(74.8, _by_task(100, 85, 91, 72, 47, 32, 98, 74)),
    "human": Figures(None, _by_task(63, 6, 59, 1, 25, 9, 30, 20)),
}
# Of multi-step planning with human instructions we know two means: GTA lifts the first
# to the second.
MULTI_STEP = {"high_level": Figures(39.8), "human": Figures(16.6)}
MULTI_STEP_GTA = {"human": Figures(27.3)}
M_CLIPORT = {"high_level": Figures(11.2)}
"""By kind of instruction."""
