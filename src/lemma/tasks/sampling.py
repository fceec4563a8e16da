"""From a key to an instance: rejection sampling with named random streams."""

import math
from dataclasses import dataclass

import numpy as np

from lemma.core.errors import InvalidConfigError, SamplingError
from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.robots.reach import reach_of
from lemma.scene.spec import ROBOT_COLORS, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.template import KINDS
from lemma.tasks.placement import Board, PlacementError
from lemma.tasks.task import Task

_SHARED_WIDTH_M = (0.22, 0.38)
_GAP_WIDTH_M = (0.06, 0.14)
_LATERAL_M = 0.05
_YAW_RAD = 0.10
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
    # What is refused does not depend on these: hard teams stay as frequent as others.
    chosen = team or _draw_team(task, stream(*key, "team"))
    distractors = int(
        stream(*key, "distractors").integers(
            task.distractors[0], task.distractors[1] + 1
        )
    )
    for rejected in range(_ATTEMPTS):
        robots = _place_team(task, chosen, rng)
        board = Board(robots, rng)
        try:
            goal = task.arrange(board)
            extra = tuple(_distract(board) for _ in range(distractors))
            board.check()
        except PlacementError:
            continue
        shuffled = [board.objects[int(i)] for i in rng.permutation(len(board.objects))]
        instance = Instance(
            task=task.name,
            split=split,
            index=index,
            scene=SceneSpec(robots, tuple(shuffled)),
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
    task: Task, team: tuple[str, ...], rng: np.random.Generator
) -> tuple[RobotPlacement, ...]:
    """Stand two robots face to face, so far apart as the task wants."""
    first, second = (reach_of(arm) for arm in team)
    if task.apart:
        # Apart even at grasp height: a gap that only the stick bridges.
        distance = first.grasp_m + second.grasp_m + rng.uniform(*_GAP_WIDTH_M)
    else:
        distance = first.travel_m + second.travel_m - rng.uniform(*_SHARED_WIDTH_M)
    # The middle of the region between them is the middle of the table.
    left = 0.5 * (distance + first.travel_m - second.travel_m)
    x = (-left, distance - left)
    robots = []
    for i in range(2):
        facing = 0.0 if i == 0 else math.pi
        base = Pose2(
            x[i],
            rng.uniform(-_LATERAL_M, _LATERAL_M),
            facing + rng.uniform(-_YAW_RAD, _YAW_RAD),
        ).rounded()
        color = ROBOT_COLORS[int(rng.integers(len(ROBOT_COLORS)))]
        robots.append(RobotPlacement(team[i], color, base))
    return tuple(robots)


def _distract(board: Board) -> str:
    """Add an object that the goal does not need, where it is not in the way."""
    kind = "cube" if board.rng.random() < 0.5 else "pad"
    if not board.has_colors(kind):
        kind = "pad" if kind == "cube" else "cube"
    put = board.cube if kind == "cube" else board.pad
    return put(board.anywhere())


def _instruct(task: Task, goal: Goal, key: tuple[str | int, ...]) -> dict[str, str]:
    return {
        kind: task.language.instruct(kind, goal.pairs, stream(*key, "language", kind))
        for kind in KINDS
    }
