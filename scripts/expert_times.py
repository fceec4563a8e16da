"""Write the table of the expert's times anew: val and test, perturbed starts too.

    python scripts/expert_times.py 2

The word is the number of processes. The same version writes the same bytes.
"""

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

from lemma.core.errors import SamplingError
from lemma.core.parallel import Engine, ProcessPool
from lemma.evaluation.run.expert_times import TIMED_SPLITS, TIMES
from lemma.evaluation.run.perturbed_starts import is_alike, perturbed
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, load_instance, task_named

TABLE = Path(__file__).parents[1] / "src" / "lemma" / "evaluation" / "run" / TIMES
_PLACES = 3
"""Decimals of times [s]: milliseconds, as in results."""
_DRAWS = 200
_CHUNK = 10


def time_expert(task: str, split: str, index: int) -> tuple[float, int, float]:
    """Let the expert solve an instance, and find its perturbed start.

    Returns:
        Its time [s], the draw of the perturbed start, and the time for that [s].

    Raises:
        SamplingError: It fails, or no perturbed start was found.
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
        f"None of {_DRAWS} perturbed starts of {instance.key} is the same problem. "
        "Move things less."
    )


def time_all(engine: Engine) -> dict[str, Any]:
    """Return the whole table, made anew."""
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
    """Return the time of the expert [s]; None if it needs more than is promised."""
    (play,) = roll_out([Rollout(instance)], Player.load(PolicySpec(ORACLE)), 1)
    promised = task_named(instance.task).subtasks
    if not play.success or len(play.steps) != promised:
        return None
    return round(play.episode.elapsed_s, _PLACES)


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
