"""From a key to an instance: rejection sampling with named random streams."""

import math
from dataclasses import dataclass

import numpy as np

from lemma.core.errors import InvalidConfigError, SamplingError
from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.objects.cube import CUBE
from lemma.scene.spec import ROBOT_COLORS, RobotPlacement, SceneSpec
from lemma.scene.table import Gap
from lemma.tasks.goal import Goal
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.template import KINDS
from lemma.tasks.placement import ObjectPlacer, PlacementError
from lemma.tasks.task import Task
from lemma.tasks.zones import FROM_EDGE_M, OUTSIDE_M

SHARED_WIDTH_M = (0.16, 0.30)
"""Width of the region where both robots work, along the line between them."""
_FIXED_WIDTH_M = 0.18
"""The same where robots always stand in the same places. In a wider region of two UR5
no place is left for what only a hook gets."""
APART_M = (-0.02, 0.05)
"""How much farther apart robots stand than a cube between them needs that neither could
touch; the stick bridges little more."""
_GAP_WIDTH_M = 0.20
"""Width of the gap in the table. A cube that is dragged into it falls."""
LATERAL_M = 0.05
"""How far a robot stands from the line through the middle of the table, at most."""
YAW_RAD = 0.10
"""How far it is turned away from that line, at most."""
_ATTEMPTS = 400


@dataclass(frozen=True, slots=True)
class Sample:
    """An instance, and how many tables were set until one was right."""

    instance: Instance
    rejected: int


def sample(
    task: Task,
    split: str,
    index: int,
    *,
    attempt: int = 0,
    team: tuple[str, ...] | None = None,
) -> Sample:
    """Sample the geometry of an instance.

    Args:
        task: The task.
        split: Name of the split, part of the key.
        index: Number in the split, part of the key.
        attempt: A later draw for the same key, when an earlier one was refused.
        team: Arm types from the first robot to the second; drawn if None.

    Raises:
        UnknownNameError: An arm type is not registered.
        InvalidConfigError: The team is not of two robots.
        SamplingError: No table was found that satisfies the task.
    """
    if team is not None and len(team) != 2:
        raise InvalidConfigError(
            f"The team {team!r} has {len(team)} robots, but tables are set for two."
        )
    key = (BENCHMARK_VERSION, task.name, split, index)
    rng = stream(*key, "layout", attempt)
    # Drawn before rejection, which cannot bias them.
    chosen = team or _draw_team(task, stream(*key, "team"))
    least, most = task.distractors
    distractors = int(stream(*key, "distractors").integers(least, most + 1))
    order = tuple(int(i) for i in stream(*key, "order").permutation(len(chosen)))
    for rejected in range(_ATTEMPTS):
        robots, gap_m = _place_team(task, chosen, order, rng)
        placer = ObjectPlacer(robots, rng, order, gap_m)
        try:
            goal = task.arrange(placer)
            extra = tuple(_distract(placer) for _ in range(distractors))
            placer.check(goal)
        except PlacementError:
            continue
        there = placer.objects
        shuffled = [there[int(i)] for i in rng.permutation(len(there))]
        instance = Instance(
            task=task.name,
            split=split,
            index=index,
            scene=SceneSpec(robots, tuple(shuffled), gap_m),
            goal=goal,
            instructions=_instruct(task, goal, key),
            distractors=extra,
        )
        return Sample(instance, rejected)
    raise SamplingError(
        f"No table for task {task.name!r} with team {'+'.join(chosen)} in {_ATTEMPTS} "
        "attempts. Loosen the zones in its arrange(), or ask for fewer objects."
    )


def _draw_team(task: Task, rng: np.random.Generator) -> tuple[str, ...]:
    first, second = task.teams[int(rng.integers(len(task.teams)))]
    return (first, second) if rng.random() < 0.5 else (second, first)


def _place_team(
    task: Task,
    team: tuple[str, ...],
    order: tuple[int, ...],
    rng: np.random.Generator,
) -> tuple[tuple[RobotPlacement, ...], Gap | None]:
    """Stand two robots face to face, so far apart as the task wants.

    Returns:
        The robots, and where the table is missing between them.
    """

    def drawn(low: float, high: float, fixed: float) -> float:
        return fixed if task.fixed else rng.uniform(low, high)

    first, second = (reach_of(arm) for arm in team)
    if task.apart:
        distance = apart_m(team, order) + drawn(*APART_M, 0.0)
    else:
        shared = drawn(*SHARED_WIDTH_M, _FIXED_WIDTH_M)
        distance = first.travel_m + second.travel_m - shared
    # The middle of the region between them is the middle of the table.
    left = 0.5 * (distance + first.travel_m - second.travel_m)
    x = (-left, distance - left)
    robots = []
    for i in range(2):
        facing = 0.0 if i == 0 else math.pi
        base = Pose2(
            x[i],
            drawn(-LATERAL_M, LATERAL_M, 0.0),
            facing + drawn(-YAW_RAD, YAW_RAD, 0.0),
        ).rounded()
        color = ROBOT_COLORS[i if task.fixed else int(rng.integers(len(ROBOT_COLORS)))]
        robots.append(RobotPlacement(team[i], color, base))
    return tuple(robots), gap_beyond(tuple(robots), order[0]) if task.apart else None


def apart_m(team: tuple[str, ...], order: tuple[int, ...]) -> float:
    """Return how far apart robots stand so that a cube fits between them.

    Neither could touch it. It lies on the table top of the second, beyond the gap,
    where the first brings nothing and pulls nothing home.
    """
    user, receiver = (could_of(team[i]) for i in order[:2])
    edge = user.place_m + OUTSIDE_M
    cube = CUBE.disc_m + FROM_EDGE_M
    beyond: float = receiver.radius_m(CUBE.disc_m) + OUTSIDE_M
    return edge + cube + beyond


def gap_beyond(robots: tuple[RobotPlacement, ...], user: int) -> Gap:
    """Return a gap beyond which a robot could put nothing."""
    robot = robots[user]
    beyond = could_of(robot.arm).place_m + OUTSIDE_M
    if user == 0:
        far = robot.base.x + beyond
        return round(far - _GAP_WIDTH_M, 4), round(far, 4)
    far = robot.base.x - beyond
    return round(far, 4), round(far + _GAP_WIDTH_M, 4)


def _distract(placer: ObjectPlacer) -> str:
    """Add an object that the goal does not need, where it is not in the way."""
    kind = "cube" if placer.rng.random() < 0.5 else "pad"
    if not placer.has_colors(kind):
        kind = "pad" if kind == "cube" else "cube"
    put = placer.cube if kind == "cube" else placer.pad
    return put(placer.anywhere())


def _instruct(task: Task, goal: Goal, key: tuple[str | int, ...]) -> dict[str, str]:
    return {
        kind: task.language.instruct(kind, goal.pairs, stream(*key, "language", kind))
        for kind in KINDS
    }
