"""Measure how well policies lay the stick beside an object that they drag next.

    python scripts/measure_laid_sticks.py [--results results]

Of all rows with high-level instructions and usual starts, it counts the sub-tasks
``prehook`` and ``prepoke`` that the expert has, too, and whose object still lies where
the instance has it. A stick is missed if the object is not in front of it. It is only
turned if another yaw at the same position of the gripper would do. It is oblique if the
expert lays it more than OBLIQUE_DEG from the axis along which most are laid: y for
``prehook``, x for ``prepoke``.
"""

import argparse
import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from itertools import compress
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
COLUMNS = ("laid", "missed", "only turned", "oblique", "oblique and missed")
EXPERT = "oracle/seed-0.jsonl.xz"
USUAL_YAW = {"prehook": 0.5 * math.pi, "prepoke": 0.0}
OBLIQUE_DEG = 40.0
YAWS = 720
"""Number of yaws to try."""

Episode = tuple[str, int]
"""Task and index of an instance."""


def oblique_ones(path: Path) -> set[Episode]:
    """Return the instances in which the expert first lays the stick obliquely."""
    found = set()
    for row in read_lines(path):
        lays = (one for one in row["subtasks"] if one["primitive"] in USES)
        first = next(lays, None)
        if first is not None:
            yaw = first["grounded"]["place"][2]
            usual = USUAL_YAW[first["primitive"]]
            off = abs(math.remainder(yaw - usual, math.pi))
            if math.degrees(off) > OBLIQUE_DEG:
                found.add((row["task"], row["index"]))
    return found


def laid(row: Row, oblique: Collection[Episode] = ()) -> Iterator[tuple[str, str]]:
    """Yield primitive and column of each sub-task of an episode that lays the stick.

    Args:
        row: The episode.
        oblique: Instances with an oblique stick.
    """
    placed = load_instance(row["task"], row["split"], row["index"]).scene.objects
    poses = {one.name: one.pose for one in placed}
    is_oblique = (row["task"], row["index"]) in oblique
    for subtask in row["subtasks"]:
        primitive, name = subtask["primitive"], subtask["place"]
        if (
            primitive in USES
            and name in poses
            and subtask["outcome"] == Outcome.SUCCESS
            and not subtask["expert"]["departure"]
        ):
            is_missed, is_turned = missed(subtask, poses[name])
            counts = (True, is_missed, is_turned, is_oblique, is_oblique and is_missed)
            yield from ((primitive, column) for column in compress(COLUMNS, counts))
        # An object that was picked or dragged may lie elsewhere now.
        poses.pop(subtask["pick"], None)
        if primitive not in USES:
            poses.pop(name, None)


def missed(subtask: Row, target: Pose2) -> tuple[bool, bool]:
    """Return whether a sub-task lays the stick beside a target, and is only turned."""
    use = USES[subtask["primitive"]]
    x, y, yaw = subtask["grounded"]["place"]

    def ready(yaw: float) -> bool:
        return is_prepared(use, stick_in_grasp(Pose2(x, y, yaw)), target)

    if ready(yaw):
        return False, False
    return True, any(ready(k * math.tau / YAWS) for k in range(YAWS))


def main(words: Sequence[str] | None = None) -> None:
    """Count, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS)
    folder: Path = parser.parse_args(words).results
    found: dict[tuple[str, str], Counter[str]] = {}
    oblique = oblique_ones(folder / EXPERT)
    for path in sorted(folder.glob("*/seed-*.jsonl.xz")):
        for row in read_lines(path):
            usual = not (row["perturb_start"] or row.get("control"))
            if usual and row["instruction_kind"] == "high_level":
                for primitive, column in laid(row, oblique):
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
