"""Pairs of one table and one sentence: one team can do it, and another one cannot.

Only the arms differ. The lack of the second team is proven as zones are, by the bound
of any posture (:mod:`lemma.tasks.teams.coalitions`). Either both arms are smaller, or
the same two stand the other way round: the types of the arms do not tell.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from lemma.core.arguments import whole
from lemma.core.errors import SamplingError
from lemma.core.poses import FloatArray
from lemma.robots.reach import reach_of
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.spec import RobotPlacement
from lemma.tasks import library  # noqa: F401 - adds the task
from lemma.tasks.goal import Goal, On
from lemma.tasks.instance import LARGEST_INDEX, Instance
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.sampling import sample
from lemma.tasks.task import TASKS
from lemma.tasks.teams.coalitions import Lack, lack_of
from lemma.tasks.zones import Mask, Territory, Zone

ABLE, UNABLE = "able", "unable"
"""Splits of the two instances of a pair."""
PAIRS = "pairs"
"""Split that has the instances of the test pairs one after another; see
:func:`instance_of_pair`."""
TEST_PAIRS = 60
"""The pairs 0 to 59 are the test list."""
PAIR_TASK = "pass"
"""The task that all of them are of."""
_TEAMS = (
    (("ur10", "ur10"), ("ur5", "ur5")),
    (("ur5", "ur10"), ("ur10", "ur5")),
    (("ur10", "ur5"), ("ur5", "ur10")),
)
"""Arms of those who can, and of those who cannot, from the first robot to the
second."""
_OUT = ("cube", "pad", "")
"""Out of everybody's reach for those who cannot; of two larger arms."""
_ATTEMPTS = 200


@dataclass(frozen=True, slots=True)
class Pair:
    """Two instances of which one can be solved."""

    able: Instance
    unable: Instance
    lack: Lack
    """Reason why the team of the second one cannot do it."""
    rejected: int = 0
    """Tables that were drawn before, on which the second team might do it, or cannot
    see everything."""


def sample_pair(index: int) -> Pair:
    """Sample a pair; a pure function of its number.

    Args:
        index: From 0.

    Raises:
        InvalidConfigError: The index is no number, or out of range.
        SamplingError: No table was found.
    """
    number = whole("index", index, 0, LARGEST_INDEX)
    large, small = _TEAMS[number % len(_TEAMS)]
    out = _OUT[number // len(_TEAMS) % len(_OUT)]
    task = replace(TASKS[PAIR_TASK], arrange=partial(_arrange, small=small, out=out))
    for attempt in range(_ATTEMPTS):
        able = sample(task, ABLE, number, attempt=attempt, team=large).instance
        robots = _with_arms(able.scene.robots, small)
        lack = _lack(robots, able)
        if lack is not None:
            scene = replace(able.scene, robots=robots)
            return Pair(able, replace(able, split=UNABLE, scene=scene), lack, attempt)
    raise SamplingError(f"No table of {_ATTEMPTS} is a pair of number {number}.")


def instance_of_pair(index: int) -> Instance:
    """Return an instance of the split :data:`PAIRS`.

    Args:
        index: From 0: twice the number of the pair for the team that can, and one more
            for the team that cannot.

    Raises:
        InvalidConfigError: The index is no number, or out of range.
    """
    number = whole("index", index, 0, 2 * TEST_PAIRS - 1)
    pair = _frozen_pair(number // 2)
    found = pair.unable if number % 2 else pair.able
    return replace(found, split=PAIRS, index=number)


def lack_in(index: int) -> Lack | None:
    """Return what the team of an instance of the split :data:`PAIRS` lacks.

    Args:
        index: As of :func:`instance_of_pair`.
    """
    return _frozen_pair(index // 2).lack if index % 2 else None


@lru_cache
def _frozen_pair(number: int) -> Pair:
    return sample_pair(number)


def _arrange(placer: ObjectPlacer, small: tuple[str, ...], out: str) -> Goal:
    """The cube must change sides; one thing may be where no other arm could touch it.

    Args:
        placer: With the team that can.
        small: Arms of the team that cannot.
        out: ``"cube"``, ``"pad"``, or ``""`` where the hand-over fails.
    """
    sides = dict(zip(("cube", "pad"), placer.order, strict=True))
    others = Territory(_with_arms(placer.robots, small), placer.gap_m)
    arms = [robot.arm for robot in placer.robots]
    pairs = zip(arms, small, strict=True)
    reach = [reach_of(arm).travel_m - reach_of(other).travel_m for arm, other in pairs]
    larger = [robot for robot in placer.order if reach[robot] > 0.0]
    if len(larger) == 1:
        # A thing can be beyond reach at one side alone.
        out = next(kind for kind, robot in sides.items() if robot in larger)

    def zone(kind: str) -> Zone:
        own = placer.only(sides[kind])
        if kind != out:
            return own

        def sift(record: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
            found = own.sift(record, x, y)
            for robot in range(len(small)):
                found &= others.cannot(robot, record, x, y)
            return found

        return replace(own, sift=sift)

    return Goal((On(placer.cube(zone("cube")), placer.pad(zone("pad"))),))


def _with_arms(
    robots: tuple[RobotPlacement, ...], arms: tuple[str, ...]
) -> tuple[RobotPlacement, ...]:
    """Return robots with other arms in their places."""
    return tuple(replace(r, arm=arm) for r, arm in zip(robots, arms, strict=True))


def _lack(robots: tuple[RobotPlacement, ...], instance: Instance) -> Lack | None:
    """Return what other arms in the same places lack, if they see all that is there."""
    territory, objects = Territory(robots, instance.scene.gap_m), instance.scene.objects
    x, y = (np.array([getattr(o.pose, axis) for o in objects]) for axis in ("x", "y"))
    if not territory.in_view(x, y).all():
        return None
    return lack_of(territory, objects, instance.goal)
