"""Why and how something is done, and what became of what visitors did."""

from dataclasses import dataclass

from lemma.policies.interfaces import Insight
from lemma.viewer.episode.planned_path import Waypoints


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why, or how, something is about to be done."""

    time_s: float
    """Simulated time [s]."""
    insight: Insight | None = None
    """What its policy perceived and weighed; None where that is not said."""
    robot: str = ""
    """Name of who shall do it."""
    waypoints: Waypoints = ()
    """Where its hand is to go [m]."""


NOTHING = Explanation(0.0)


@dataclass(frozen=True, slots=True)
class Moved:
    """What somebody wanted to lay elsewhere, and what became of it."""

    name: str
    problem: str = ""
    """Why it could not be; empty if it was."""
