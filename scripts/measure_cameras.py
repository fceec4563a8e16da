"""Measure the widths of cubes in the images of each camera, in pixels.

    python scripts/measure_cameras.py [--instances 6] [--per-task]

The expert plays some test instances of each task. A width is that of a cube's edge at
the distance of its center. A cube counts as seen if at least half of its pixels are
visible, neither occluded nor outside of the image. During grasps, every half second,
the held cube is measured with the cameras of the robot that holds it.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from lemma.core.poses import FloatArray
from lemma.core.tables import Table
from lemma.env.camera_rig import (
    CameraRig,
    camera_names,
    close_cameras,
    reach_name,
    wrist_name,
)
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.scene.cameras import CLOSE_PX, Camera
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.suite import SUITE, load_instance

OLD_SIZE = (160, 120)
"""The size that the docs recommended for the robots' own cameras [px]."""
NEW_SIZE = (CLOSE_PX, CLOSE_PX)
"""The size of images at control level [px]."""
SEEN = 0.5
"""Smallest share of visible pixels of a cube that counts as seen."""
EVERY_TICKS = 50
"""Ticks between measurements of grasps: half a second."""
CORNERS = 0.5 * CUBE_EDGE_M * np.array(list(product((-1.0, 1.0), repeat=3)))
"""Corners of a cube in its own frame, (8, 3) [m]."""
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4))
FACES = (*_FACES, (1, 3, 7, 5))
"""Corners of each face, in order around it."""


@dataclass(slots=True)
class Figures:
    """Cubes in the images of a camera, of one size."""

    widths: list[float] = field(default_factory=list)
    """Widths of seen cubes at the start [px]."""
    asked: int = 0
    """Number of cubes at the start."""
    held_widths: list[float] = field(default_factory=list)
    """Widths of seen cubes in a hand [px]."""
    held: int = 0
    """Number of measurements of cubes in a hand."""

    def add(self, widths: Mapping[str, float], held: Mapping[str, str]) -> None:
        """Count cubes by their widths, 0 for those that are not seen.

        Args:
            widths: Widths by name of the cube [px].
            held: Held object by robot; empty at the start.
        """
        seen = [width for width in widths.values() if width > 0.0]
        if held:
            self.held += len(widths)
            self.held_widths += seen
        else:
            self.asked += len(widths)
            self.widths += seen

    def row(self) -> tuple[str, ...]:
        """Return the figures as cells."""
        return (
            f"{len(self.widths) / max(1, self.asked):.0%}",
            _spread(self.widths),
            f"{1.0 - len(self.held_widths) / max(1, self.held):.0%}",
            _spread(self.held_widths),
        )


def _spread(widths: Sequence[float]) -> str:
    if not widths:
        return "-"
    return " / ".join(f"{x:.1f}" for x in np.percentile(widths, (0, 50, 100)))


def silhouette_px(camera: Camera, corners_world: FloatArray) -> float:
    """Return the area of a cube's outline in an image [px²]; NaN behind the camera.

    Args:
        camera: The camera.
        corners_world: Corners in the order of :data:`CORNERS`, (8, 3) [m].
    """
    u, v = camera.project(corners_world)[0].T
    twice = [
        abs(np.dot(u[f], np.roll(v[f], -1)) - np.dot(v[f], np.roll(u[f], -1)))
        for f in (list(face) for face in FACES)
    ]
    # Half of the sum, because each line of sight meets two faces.
    return 0.25 * sum(twice)


def moments(instance: Instance) -> Iterator[tuple[Scene, FloatArray, dict[str, str]]]:
    """Yield scene, joint state and held objects at the start and during grasps."""
    episode = Episode(instance)
    simulation = episode.simulation
    yield simulation.scene, simulation.scene.data.qpos.copy(), {}
    found: list[tuple[FloatArray, dict[str, str]]] = []
    ticks = 0

    def look() -> None:
        nonlocal ticks
        ticks += 1
        if ticks % EVERY_TICKS == 0:
            held = simulation.held()
            cubes = {r: name for r, name in held.items() if name.endswith("cube")}
            if cubes:
                found.append((simulation.scene.data.qpos.copy(), cubes))

    simulation.observers.append(look)
    for _ in solve(episode, Expert(simulation.scene, instance.goal)):
        pass
    for qpos, cubes in found:
        yield simulation.scene, qpos, cubes


class Ruler:
    """Measures cubes in images of one size."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Store the size; the first image starts OpenGL."""
        self._rig, self._renderer = CameraRig(*size), Renderer(*size)
        self.size = size

    def measure(
        self, scene: Scene, qpos: FloatArray, camera_name: str, cubes: Sequence[str]
    ) -> dict[str, float]:
        """Return the width of each cube [px]; 0 if it is not seen."""
        data = scene.posed(qpos)
        camera = self._rig.calibrated(scene, data, camera_name)
        geoms = self._renderer.segmentation(scene.model, data, camera)
        bodies = np.where(geoms >= 0, scene.model.geom_bodyid[geoms], -1)
        found = {}
        for cube in cubes:
            body = scene.model.body(cube).id
            middle = data.xpos[body]
            corners = middle + CORNERS @ data.xmat[body].reshape(3, 3).T
            # NaN, for a corner behind the camera, makes the comparison False.
            outline = silhouette_px(camera, corners)
            is_seen = (bodies == body).sum() >= SEEN * outline
            (depth,) = camera.project([middle])[1]
            width = camera.intrinsics.fx * CUBE_EDGE_M / depth
            found[cube] = float(width) if is_seen else 0.0
        return found


Key = tuple[str, str, str]
"""Task, size, and kind of camera."""


def measure(instances: Sequence[Instance], *, per_task: bool) -> dict[Key, Figures]:
    """Measure instances with all cameras, at the old size and at the new one.

    Args:
        instances: Instances for the expert.
        per_task: Whether to separate the tasks.
    """
    found: dict[Key, Figures] = defaultdict(Figures)
    rulers = (Ruler(OLD_SIZE), Ruler(NEW_SIZE))
    for instance in instances:
        task = instance.task if per_task else "all"
        names = instance.scene.robot_names
        arms = {n: r.arm for n, r in zip(names, instance.scene.robots, strict=True)}
        groups = {
            "robot_N, both": names,
            "robot_N_reach, both": tuple(map(reach_name, names)),
            "all of the control level": close_cameras(names),
        }
        for scene, qpos, held in moments(instance):
            cubes = [name for name in scene.object_names if name.endswith("cube")]
            for ruler in rulers:
                size = "{} x {}".format(*ruler.size)
                seen: dict[str, dict[str, float]] = {}
                for name in camera_names(names):
                    robot = next((r for r in names if name.startswith(r)), None)
                    in_hand = [c for r, c in held.items() if robot in (None, r)]
                    seen[name] = ruler.measure(
                        scene, qpos, name, in_hand if held else cubes
                    )
                    found[task, size, kind_of(name, arms)].add(seen[name], held)
                for kind, cameras in groups.items():
                    best: dict[str, float] = {}
                    for name in cameras:
                        for cube, width in seen[name].items():
                            best[cube] = max(best.get(cube, 0.0), width)
                    found[task, size, kind].add(best, held)
    return dict(found)


def kind_of(camera: str, arms: Mapping[str, str]) -> str:
    """Return the kind of a camera, with the arm if its field of view depends on it.

    Args:
        camera: Name of the camera.
        arms: Arm types by name of the robot.
    """
    for robot, arm in arms.items():
        if camera.startswith(robot):
            kind = f"robot_N{camera.removeprefix(robot)}"
            return kind if camera == wrist_name(robot) else f"{kind}, {arm.upper()}"
    return camera


def table_of(figures: dict[Key, Figures]) -> Table:
    """Return the figures of :func:`measure` as a table."""
    return Table(
        (
            *("tasks", "pictures [px]", "camera", "seen"),
            *("width [px]: min / median / max", "in a grasp: hidden", "width [px]"),
        ),
        tuple((*key, *figures[key].row()) for key in sorted(figures)),
        labels=3,
    )


def main(words: Sequence[str] | None = None) -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--instances", type=int, default=6, help="of each task")
    parser.add_argument("--per-task", action="store_true")
    asked = parser.parse_args(words)
    instances = [
        load_instance(task, "test", index)
        for task in SUITE
        for index in range(asked.instances)
    ]
    print(table_of(measure(instances, per_task=asked.per_task)).markdown(), end="")


if __name__ == "__main__":
    main()
