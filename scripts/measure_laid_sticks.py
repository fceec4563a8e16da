"""Measure how well policies lay the stick beside an object that they drag next.

    python scripts/measure_laid_sticks.py [--results results]

Of all rows with high-level instructions and usual starts, it counts the sub-tasks
``prehook`` and ``prepoke`` that the expert has, too, and whose object still lies where
the instance has it. A stick is missed if the object is not in front of it. It is only
turned if another yaw at the same position of the gripper would do.
"""

import argparse
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from lemma.core.poses import Pose2
from lemma.core.tables import Table
from lemma.evaluation.lines import read_lines
from lemma.evaluation.records import Row
from lemma.motion.outcome import Outcome
from lemma.tasks.drags import is_prepared, stick_in_grasp
from lemma.tasks.subtask import Primitive
from lemma.tasks.suite import load_instance

RESULTS = Path(__file__).parents[1] / "results"
USES = {"prehook": Primitive.HOOK, "prepoke": Primitive.POKE}
COLUMNS = ("laid", "missed", "only turned")
YAWS = 720
"""Number of yaws to try."""


def laid(row: Row) -> Iterator[tuple[str, str]]:
    """Yield primitive and column of each sub-task of an episode that lays the stick."""
    placed = load_instance(row["task"], row["split"], row["index"]).scene.objects
    poses = {one.name: one.pose for one in placed}
    for subtask in row["subtasks"]:
        primitive, name = subtask["primitive"], subtask["place"]
        if (
            primitive in USES
            and name in poses
            and subtask["outcome"] == Outcome.SUCCESS
            and not subtask["expert"]["departure"]
        ):
            yield primitive, COLUMNS[0]
            yield from ((primitive, how) for how in missed(subtask, poses[name]))
        # An object that was picked or dragged may lie elsewhere now.
        poses.pop(subtask["pick"], None)
        if primitive not in USES:
            poses.pop(name, None)


def missed(subtask: Row, target: Pose2) -> Iterator[str]:
    """Yield the further columns of a sub-task that lays the stick beside a target."""
    use = USES[subtask["primitive"]]
    x, y, yaw = subtask["grounded"]["place"]

    def ready(yaw: float) -> bool:
        return is_prepared(use, stick_in_grasp(Pose2(x, y, yaw)), target)

    if not ready(yaw):
        yield COLUMNS[1]
        if any(ready(k * math.tau / YAWS) for k in range(YAWS)):
            yield COLUMNS[2]


def main(words: Sequence[str] | None = None) -> None:
    """Count, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS)
    folder: Path = parser.parse_args(words).results
    found: dict[tuple[str, str], Counter[str]] = {}
    for path in sorted(folder.glob("*/seed-*.jsonl.xz")):
        for row in read_lines(path):
            usual = not (row["perturb_start"] or row.get("control"))
            if usual and row["instruction_kind"] == "high_level":
                for primitive, column in laid(row):
                    key = path.parent.name, primitive
                    found.setdefault(key, Counter())[column] += 1
    shown = (
        (*key, *(str(counts[column]) for column in COLUMNS))
        for key, counts in found.items()
    )
    header = ("row", "sub-task", *COLUMNS)
    print(Table(header, tuple(shown), labels=2).markdown(), end="")


if __name__ == "__main__":
    main()
