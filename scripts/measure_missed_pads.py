"""Measure where policies put things that miss their pad.

    python scripts/measure_missed_pads.py [--results results]

Of all rows with high-level instructions, it counts the sub-tasks with a pad as their
place, where the expert has the same sub-task, and the poses that are off by more than
POSE_TOLERANCE_MM: beside the pad itself, on a pad of another color, where
resting arms hide the table from the map, or elsewhere. Pads do not move, so they are
where the instance has them. Rows in which nothing is missed
are left out, and M-CLIPort, which names no place.
"""

import argparse
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from lemma.core.tables import Table
from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.evaluation.lines import read_lines
from lemma.evaluation.records import POSE_TOLERANCE_MM, Row
from lemma.scene.objects.pad import PAD
from lemma.scene.raster import RASTER
from lemma.tasks.instance import Instance
from lemma.tasks.suite import load_instance

RESULTS = Path(__file__).parents[1] / "results"
COLUMNS = (
    *("onto pads", "missed"),
    *("beside it", "another pad", "hidden table", "elsewhere"),
)
NEAR = 6
"""Number of cells of the map on each side of a place to look at."""
FEWEST = 0.1
"""Smallest share of seen cells with which a place counts as seen."""


def where(row: Row) -> Iterator[str]:
    """Yield the column of each sub-task of an episode with a pad as its place."""
    instance = load_instance(row["task"], row["split"], row["index"])
    things = (one for one in instance.scene.objects if one.kind == PAD.name)
    pads = {f"{one.color}_{one.kind}": one.pose for one in things}
    for subtask in row["subtasks"]:
        error = (subtask["expert"] or {}).get("place_error_mm")
        if error is None or subtask["place"] not in pads:
            continue
        yield COLUMNS[0]
        if error <= POSE_TOLERANCE_MM:
            continue
        x, y, _ = subtask["grounded"]["place"]
        near = min(pads, key=lambda name: math.dist(pads[name].xy, (x, y)))
        if math.dist(pads[near].xy, (x, y)) <= PAD.disc_m:
            yield "beside it" if near == subtask["place"] else "another pad"
        else:
            yield "elsewhere" if is_seen(instance, x, y) else "hidden table"


def counted(path: Path) -> Counter[str]:
    """Return the number of sub-tasks of each column in a file of lines."""
    lines = (row for row in read_lines(path) if row["instruction_kind"] == "high_level")
    found = Counter(column for row in lines for column in where(row))
    found["missed"] = sum(found[column] for column in COLUMNS[2:])
    return found


def is_seen(instance: Instance, x: float, y: float) -> bool:
    """Return whether the first map of an instance shows the table at a place."""
    view = CameraRig().look(Episode(instance).simulation.scene)
    cell = RASTER.pixel_from_world(x, y)
    rows, columns = (slice(max(0, i - NEAR), i + NEAR + 1) for i in cell)
    return bool(view.coverage[rows, columns].mean() >= FEWEST)


def main(words: Sequence[str] | None = None) -> None:
    """Count, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS)
    folder: Path = parser.parse_args(words).results
    rows = []
    for row in sorted({path.parent for path in folder.glob("*/seed-*.jsonl.xz")}):
        whole: Counter[str] = Counter()
        paths = sorted(row.glob("seed-*.jsonl.xz"))
        for path in paths:
            found = counted(path)
            rows.append((f"{row.name}, {path.name.split('.')[0]}", found))
            whole += found
        if len(paths) > 1:
            rows.append((f"{row.name}, all seeds", whole))
    shown = (
        (name, *(str(found[column]) for column in COLUMNS))
        for name, found in rows
        if found["missed"]
    )
    print(Table(("row", *COLUMNS), tuple(shown), labels=1).markdown(), end="")


if __name__ == "__main__":
    main()
