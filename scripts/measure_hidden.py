"""Measure how often a part of a goal is hidden from the top-down map.

    python scripts/measure_hidden.py [--episodes 60] [--row reachnet]

The map is fused from the cameras above the robots, whose arms hide things. An object is
hidden if each of these images has fewer than FEWEST pixels of it, and nothing lies on
it. Printed are

- the instances of the test split in which a part of the goal, or the stick, is hidden
  at the first decision, and the success of all rows with and without it (high-level
  instructions, strict, all training seeds);
- for one row, the failed episodes in which a part was hidden at some decision, and the
  same for as many successful ones of the same tasks: their decisions are replayed.
"""

import argparse
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from lemma.core.tables import Table
from lemma.env.camera_rig import TABLE_NAME, CameraRig
from lemma.env.episode import Episode
from lemma.evaluation.lines import read_lines
from lemma.evaluation.records import Row
from lemma.evaluation.report.policy_results import read_results
from lemma.evaluation.run.evaluate import start_of
from lemma.evaluation.run.replay import play_again
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.suite import SUITE, load_instance

FEWEST = 10
"""Number of pixels that make an object visible; a cube has about 100."""
FLAT_M = 0.02
"""An object that lies on another has its middle at least so much higher [m]."""
RESULTS = Path(__file__).parents[1] / "results"

Place = tuple[str, int]
"""Task and number of an instance."""


class Eye:
    """The cameras, with a look for hidden objects."""

    def __init__(self) -> None:
        """Prepare the cameras, at the size from which maps are fused."""
        self._rig = CameraRig()
        self._renderer = Renderer(CAMERA_WIDTH_PX, CAMERA_HEIGHT_PX)

    def hidden(self, episode: Episode) -> Iterator[tuple[str, bool]]:
        """Yield the hidden parts of a goal, and whether the table camera sees them."""
        scene, goal = episode.simulation.scene, episode.instance.goal
        parts = {name for pair in goal.pairs for name in pair} | {STICK}
        robots = [self._count(scene, name) for name in scene.spec.robot_names]
        above = self._count(scene, TABLE_NAME)
        for name in parts & {*scene.object_names}:
            seen = max(count[name] for count in robots) >= FEWEST
            if not (seen or is_below(scene, name)):
                yield name, above[name] >= FEWEST

    def _count(self, scene: Scene, camera: str) -> Counter[str | None]:
        """Return the number of pixels of each object in a camera's image."""
        data = scene.posed(scene.data.qpos)
        calibrated = self._rig.calibrated(scene, data, camera)
        geoms = self._renderer.segmentation(scene.model, data, calibrated)
        bodies, counts = np.unique(
            scene.model.geom_bodyid[geoms[geoms >= 0]], return_counts=True
        )
        found: Counter[str | None] = Counter()
        for body, count in zip(bodies.tolist(), counts.tolist(), strict=True):
            found[scene.entity_of_body(body)] += count
        return found


def is_below(scene: Scene, name: str) -> bool:
    """Return whether another object lies on an object, which may then be hidden."""
    x, y, z = scene.position(name)
    others = (scene.position(other) for other in scene.movable_names if other != name)
    return any(
        math.dist((x, y), at[:2]) < CUBE_EDGE_M and at[2] > z + FLAT_M for at in others
    )


def high_level(name: str) -> Iterator[Row]:
    """Yield the lines of a row with high-level instructions, of all seeds."""
    for path in sorted((RESULTS / name).glob("seed-*.jsonl.xz")):
        lines = read_lines(path)
        yield from (row for row in lines if row["instruction_kind"] == "high_level")


def rates(places: set[Place]) -> Table:
    """Return the success rates of all rows at some instances, and at all others."""
    rows = []
    for folder in sorted(path.parent for path in RESULTS.glob("*/seed-0.jsonl.xz")):
        counts = defaultdict(list)
        for row in high_level(folder.name):
            counts[(row["task"], row["index"]) in places].append(row["success"])
        rows.append((folder.name, _rate(counts[False]), _rate(counts[True])))
    return Table(("row", "all are visible", "one is hidden"), tuple(rows), labels=1)


def _rate(won: Sequence[bool]) -> str:
    share = 100.0 * sum(won) / max(len(won), 1)
    return f"{sum(won)} of {len(won)} ({share:.1f} %)"


def again(eye: Eye, name: str) -> Iterator[tuple[bool, bool]]:
    """Yield success, and whether a part was hidden at a decision, of replayed lines."""
    about = read_results([RESULTS / name])[0].about
    lines = list(high_level(name))
    failed = [row for row in lines if not row["success"]]
    tasks = [row["task"] for row in failed]
    for task in dict.fromkeys(tasks):
        good = (row for row in lines if row["task"] == task and row["success"])
        failed += islice(good, tasks.count(task))
    for row in failed:
        found: set[str] = set()

        def watch(episode: Episode, number: int, found: set[str] = found) -> None:
            if not episode.is_over:
                found |= {part for part, _ in eye.hidden(episode)}

        play_again(row, start_of(row), about, watch, strictly=True)
        place = row["task"], row["index"], "solved" if row["success"] else "failed"
        print(*place, *sorted(found))
        yield row["success"], bool(found)


def main(words: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--episodes", type=int, default=60, help="of each task")
    parser.add_argument("--row", default="reachnet", help="row to replay; or none")
    asked = parser.parse_args(words)
    eye, places = Eye(), set[Place]()
    for task in SUITE:
        for index in range(asked.episodes):
            episode = Episode(load_instance(task, "test", index))
            for name, above in eye.hidden(episode):
                places.add((task, index))
                print(task, index, name, "seen" if above else "hidden", "from above")
    print(f"{len(places)} of {len(SUITE) * asked.episodes} instances")
    print(rates(places).markdown(), end="")
    if asked.row != "none":
        counts = defaultdict(list)
        for success, some in again(eye, asked.row):
            counts[success].append(some)
        for success, word in ((False, "failed"), (True, "successful")):
            print(f"hidden in {_rate(counts[success])} of the {word} episodes")


if __name__ == "__main__":
    main()
