"""Timing disturbances: robots that are slower than usual.

Only the timing is disturbed: a slow arm follows the same path, and a stopped arm stands
still and keeps its grasp. No arm is faster than without disturbance. A disturbance is a
function of the instance, the robot and the time at which its sub-task began, so it is
the same in every run.
"""

from collections.abc import Callable
from typing import Final

from lemma.core.arguments import known
from lemma.core.seeding import stream
from lemma.env.episode import Episode
from lemma.env.simulation import Pace
from lemma.tasks.instance import Instance

SPREAD = 0.3
"""Factors of durations are uniform in 1 +- this, divided by 1 - this."""
SLOW = 0.5
"""Speed factor of the slow robot."""
REST_S = 20.0
"""Duration of the stop [s]."""
REST_FROM_S = (2.0, 8.0)
"""Range of the time at which the stop begins [s]."""


def disturb(episode: Episode, kind: str) -> None:
    """Disturb the robots of a new episode.

    Args:
        episode: Episode at its start.
        kind: One of :data:`DISTURBANCES`.

    Raises:
        UnknownNameError: There is no such disturbance.
    """
    make = DISTURBANCES[known("disturbance", kind, DISTURBANCES)]
    episode.simulation.pace = make(episode.instance)


def _durations(instance: Instance) -> Pace:
    """Return speed factors for sub-tasks that take 1 to 1.86 times as long."""

    def pace(robot: str, start_s: float, now_s: float) -> float:
        rng = stream(instance.key, "durations", robot, round(1000.0 * start_s))
        return (1.0 - SPREAD) / float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD))

    return pace


def _slow(instance: Instance) -> Pace:
    """Return speed factors of a team with one robot at half speed."""
    names = instance.scene.robot_names
    slow = names[int(stream(instance.key, "slow").integers(len(names)))]
    return lambda robot, start_s, now_s: SLOW if robot == slow else 1.0


def _stops(instance: Instance) -> Pace:
    """Return speed factors of a team with one robot that stops for a while."""
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
"""Disturbances by name: random durations of sub-tasks; a slow robot; a stop."""
