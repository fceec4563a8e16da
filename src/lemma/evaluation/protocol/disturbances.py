"""Disturbed robots: a policy meets partners that are not as quick as it expects.

Only time is disturbed: an arm that is slow goes the same way, and one at rest
stands still wherever it is, with what it holds. No arm is quicker than undisturbed, so
all durations can only grow. A disturbance is a function of the instance, the robot and
the time at which its sub-task began: it is the same in every run.
"""

from collections.abc import Callable
from typing import Final

from lemma.core.arguments import known
from lemma.core.seeding import stream
from lemma.env.episode import Episode
from lemma.env.simulation import Pace
from lemma.tasks.instance import Instance

SPREAD = 0.3
"""Durations are 1 +- this, over 1 - this."""
SLOW = 0.5
"""How fast the slow robot is."""
REST_S = 20.0
"""How long the robot that stops stands still [s]."""
REST_FROM_S = (2.0, 8.0)
"""It does so from some time between these on [s]."""


def disturb(episode: Episode, kind: str) -> None:
    """Disturb the robots of an episode that begins.

    Args:
        episode: Any.
        kind: One of :data:`DISTURBANCES`.

    Raises:
        UnknownNameError: There is no such disturbance.
    """
    make = DISTURBANCES[known("disturbance", kind, DISTURBANCES)]
    episode.simulation.pace = make(episode.instance)


def _durations(instance: Instance) -> Pace:
    """Return the pace of robots whose sub-tasks take 1 to 1.86 times as long."""

    def pace(robot: str, start_s: float, now_s: float) -> float:
        rng = stream(instance.key, "durations", robot, round(1000.0 * start_s))
        return (1.0 - SPREAD) / float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD))

    return pace


def _slow(instance: Instance) -> Pace:
    """Return the pace of a team in which one robot is half as fast."""
    names = instance.scene.robot_names
    slow = names[int(stream(instance.key, "slow").integers(len(names)))]
    return lambda robot, start_s, now_s: SLOW if robot == slow else 1.0


def _stops(instance: Instance) -> Pace:
    """Return the pace of a team in which one robot stands still for a while."""
    names, rng = instance.scene.robot_names, stream(instance.key, "stops")
    still = names[int(rng.integers(len(names)))]
    from_s = float(rng.uniform(*REST_FROM_S))

    def pace(robot: str, start_s: float, now_s: float) -> float:
        rests = robot == still and from_s <= now_s < from_s + REST_S
        return 0.0 if rests else 1.0

    return pace


DISTURBANCES: Final[dict[str, Callable[[Instance], Pace]]] = {
    "durations": _durations,
    "slow": _slow,
    "stops": _stops,
}
"""By name: every sub-task takes a time of its own; one robot is slow; one stops."""
