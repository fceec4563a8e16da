"""Samples the instance of a key: rejection sampling with named random streams."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lemma.core.errors import InvalidConfigError, SamplingError
from lemma.core.seeding import stream
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.scene.table import Gap
from lemma.tasks.goal import Goal
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.bank import robot_phrases, say_rule
from lemma.tasks.language.template import KINDS
from lemma.tasks.placement import ObjectPlacer, PlacementError
from lemma.tasks.task import Task
from lemma.tasks.teams.layouts import LAYOUTS, PAIR, Layout, place_pair

_ATTEMPTS = 400


@dataclass(frozen=True, slots=True)
class Sample:
    """An instance, with the number of rejected attempts."""

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
        index: Index in the split, part of the key.
        attempt: Number of the draw for the same key, if earlier draws were refused.
        team: Arm types of the robots in order; drawn if None.

    Raises:
        UnknownNameError: An arm type is not registered.
        InvalidConfigError: The team has another size than the task's.
        SamplingError: No table was found that satisfies the task.
    """
    layout = LAYOUTS[task.layout]
    if team is not None and len(team) != layout.size:
        raise InvalidConfigError(
            f"The team {team!r} has {len(team)} robots, but tables of task "
            f"{task.name!r} are set for {layout.size}."
        )
    key = (BENCHMARK_VERSION, task.name, split, index)
    rng = stream(*key, "layout", attempt)
    # Drawn before rejection sampling, so that rejections do not bias them.
    chosen = team or _draw_team(task, stream(*key, "team"))
    least, most = task.distractors
    distractors = int(stream(*key, "distractors").integers(least, most + 1))
    order = _draw_order(layout, stream(*key, "order"))
    rule = str(stream(*key, "rule").choice(task.rules)) if task.rules else ""
    for rejected in range(_ATTEMPTS):
        try:
            robots, gap_m = _place_team(task, chosen, order, rng)
            placer = ObjectPlacer(robots, rng, order, gap_m)
            placer.rule = rule
            goal = task.arrange(placer)
            extra = tuple(_distract(placer) for _ in range(distractors))
            placer.check(goal)
        except PlacementError:
            continue
        instance = Instance(
            task=task.name,
            split=split,
            index=index,
            scene=SceneSpec(robots, _shuffled(placer.objects, rng), gap_m),
            goal=goal,
            instructions=_instruct(task, goal, key, robots),
            distractors=extra,
        )
        return Sample(instance, rejected)
    raise SamplingError(
        f"No table for task {task.name!r} with team {'+'.join(chosen)} in {_ATTEMPTS} "
        "attempts. Loosen the zones in its arrange(), or ask for fewer objects."
    )


def _shuffled(
    objects: Sequence[ObjectPlacement], rng: np.random.Generator
) -> tuple[ObjectPlacement, ...]:
    return tuple(objects[int(i)] for i in rng.permutation(len(objects)))


def _draw_team(task: Task, rng: np.random.Generator) -> tuple[str, ...]:
    team = task.teams[int(rng.integers(len(task.teams)))]
    # Larger teams are listed in the order of the layout; their roles are drawn.
    return team if len(team) > 2 or rng.random() < 0.5 else team[::-1]


def _draw_order(layout: Layout, rng: np.random.Generator) -> tuple[int, ...]:
    if layout.size == 2:
        return tuple(int(i) for i in rng.permutation(2))
    return layout.orders[int(rng.integers(len(layout.orders)))]


def _place_team(
    task: Task,
    team: tuple[str, ...],
    order: tuple[int, ...],
    rng: np.random.Generator,
) -> tuple[tuple[RobotPlacement, ...], Gap | None]:
    """Place the robots around the table, each with its hand.

    Raises:
        PlacementError: They do not fit.
    """
    gap_m = None
    if task.layout == PAIR:
        there, gap_m = place_pair(team, order, rng, fixed=task.fixed, apart=task.apart)
    else:
        layout = LAYOUTS[task.layout]
        placed = layout.place(team, rng)
        if placed is None:
            raise PlacementError(task.layout)
        there = placed
        gap_m = layout.split(placed) if layout.split is not None else None
    hands = task.hands_of(order)
    robots = (replace(r, hand=h) for r, h in zip(there, hands, strict=True))
    return tuple(robots), gap_m


def _distract(placer: ObjectPlacer) -> str:
    """Add a distractor and return its name."""
    kind = "cube" if placer.rng.random() < 0.5 else "pad"
    if not placer.has_colors(kind):
        kind = "pad" if kind == "cube" else "cube"
    put = placer.cube if kind == "cube" else placer.pad
    return put(placer.anywhere())


def _instruct(
    task: Task,
    goal: Goal,
    key: tuple[str | int, ...],
    robots: tuple[RobotPlacement, ...],
) -> dict[str, str]:
    said = {
        kind: task.language.instruct(kind, goal.pairs, stream(*key, "language", kind))
        for kind in KINDS
    }
    if (rule := goal.rule) is None:
        return said
    phrases, draw = robot_phrases(robots), partial(stream, *key, "language")
    return {
        kind: say_rule(rule, kind, what, phrases, draw(kind, "rule"))
        for kind, what in said.items()
    }
