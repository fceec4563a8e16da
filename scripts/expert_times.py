"""Write the table of the expert's times for val and test, with perturbed starts.

    python scripts/expert_times.py 2

The argument is the number of processes. The same version writes the same bytes.
"""

import json
import sys
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from lemma.core.errors import SamplingError
from lemma.core.poses import Pose2
from lemma.core.workers.pool import Engine, ProcessPool
from lemma.evaluation.protocol.expert_times import TIMED_SPLITS, TIMES
from lemma.evaluation.protocol.perturbed_starts import (
    APART_M,
    FROM_STICK_M,
    perturbed,
)
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.scene.camera_mounts import CameraFootprint
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M
from lemma.scene.spec import ObjectPlacement, SceneSpec
from lemma.scene.table import Gap, lies_on_table
from lemma.tasks.drags import stick_gap
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, TASKS, load_instance
from lemma.tasks.zones import Territory

TABLE = Path(__file__).parents[1] / "src" / "lemma" / "evaluation" / "protocol" / TIMES
_PLACES = 3
"""Decimal places of times [s]: milliseconds, as in results."""
_DRAWS = 200
_CHUNK = 10
_EDGE_M = 0.03
"""Smallest distance of objects from the edge of the table [m]."""


def time_expert(task: str, split: str, index: int) -> tuple[float, int, float]:
    """Solve an instance with the expert, and find its perturbed start.

    Returns:
        The time [s], the number of the perturbed start's draw, and the time for it [s].

    Raises:
        SamplingError: The expert fails, or there is no valid perturbed start.
    """
    instance = load_instance(task, split, index)
    elapsed = _solved_s(instance)
    if elapsed is None:
        raise SamplingError(
            f"The expert does not solve {instance.key}. Freeze the instances anew."
        )
    for draw in range(_DRAWS):
        moved = perturbed(instance, draw)
        if is_alike(moved.scene, instance.scene):
            moved_s = _solved_s(moved)
            if moved_s is not None:
                return elapsed, draw, moved_s
    raise SamplingError(
        f"None of {_DRAWS} perturbed starts of {instance.key} is equivalent to the "
        "instance. Use smaller perturbations."
    )


def time_all(engine: Engine) -> dict[str, Any]:
    """Compute the whole table."""
    jobs = [
        (task, split, range(start, min(start + _CHUNK, SPLITS[split])))
        for split in TIMED_SPLITS
        for task in SUITE
        for start in range(0, SPLITS[split], _CHUNK)
    ]
    found: dict[tuple[str, str, int], tuple[float, int, float]] = {}
    for group in engine.run(_time_group, jobs):
        found.update(group)
    return {
        split: {
            task: dict(
                zip(
                    ("elapsed_s", "draw", "perturbed_s"),
                    map(list, zip(*listed, strict=True)),
                    strict=True,
                )
            )
            for task in SUITE
            for listed in [[found[task, split, i] for i in range(SPLITS[split])]]
        }
        for split in TIMED_SPLITS
    }


def _time_group(
    task: str, split: str, indices: range
) -> dict[tuple[str, str, int], tuple[float, int, float]]:
    each = partial(time_expert, task, split)
    return {(task, split, index): each(index) for index in indices}


def _solved_s(instance: Instance) -> float | None:
    """Return the expert's time [s]; None if its plan is longer than the task's."""
    (play,) = roll_out([Rollout(instance)], Player.load(PolicySpec(ORACLE)), 1)
    promised = TASKS[instance.task].subtasks
    if not play.success or len(play.steps) != promised:
        return None
    return round(play.episode.elapsed_s, _PLACES)


def is_alike(scene: SceneSpec, original: SceneSpec) -> bool:
    """Return whether a perturbed scene is equivalent to the original one."""
    territory = Territory(scene.robots, scene.gap_m)
    views = [CameraFootprint(robot) for robot in scene.robots]

    def seen(pose: Pose2) -> bool:
        at = (np.array([pose.x]), np.array([pose.y]))
        return any(bool(view.sees(*at)[0]) for view in views)

    pairs = zip(scene.objects, original.objects, strict=True)
    return all(
        _is_reached(territory, now) == _is_reached(territory, before)
        and seen(now.pose)
        and _is_on_table(now, scene.gap_m)
        for now, before in pairs
    ) and all(
        _are_apart(one, another) for one, another in combinations(scene.objects, 2)
    )


def _is_reached(
    territory: Territory, placed: ObjectPlacement
) -> list[tuple[bool, bool]]:
    """Return for each robot whether it surely reaches, and whether it surely cannot."""
    x, y, kind = (
        np.array([placed.pose.x]),
        np.array([placed.pose.y]),
        placed.entity.kind,
    )
    return [
        (
            bool(territory.works(robot, x, y)[0]),
            bool(territory.cannot(robot, kind, x, y)[0]),
        )
        for robot in range(len(territory.robots))
    ]


def _is_on_table(placed: ObjectPlacement, gap_m: Gap | None) -> bool:
    ends = [placed.pose]
    if placed.name == STICK:
        ends.append(placed.pose @ Pose2(HANDLE_LENGTH_M, 0.0))
        ends.append(placed.pose @ Pose2(HANDLE_LENGTH_M, HOOK_LENGTH_M))
    return all(lies_on_table(gap_m, end, _EDGE_M) for end in ends)


def _are_apart(one: ObjectPlacement, another: ObjectPlacement) -> bool:
    if one.name == STICK:
        one, another = another, one
    if another.name == STICK:
        return stick_gap(another.pose, one.pose.x, one.pose.y) >= FROM_STICK_M
    return one.pose.distance(another.pose) >= APART_M


if __name__ == "__main__":
    table = time_all(ProcessPool(int(sys.argv[1])))
    lines = [
        f'"{split}": {{\n'
        + ",\n".join(
            f' "{task}": {{\n'
            + ",\n".join(f'  "{k}": {json.dumps(v)}' for k, v in entry.items())
            + "\n }"
            for task, entry in tasks.items()
        )
        + "\n}"
        for split, tasks in table.items()
    ]
    TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
