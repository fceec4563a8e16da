"""What the symbolic planner knows of the world: where things are and on what."""

from dataclasses import dataclass, replace

from lemma.core.poses import Pose2
from lemma.scene.objects import CUBE_EDGE_M, PAD_RADIUS_M
from lemma.scene.scene import Scene
from lemma.scene.spec import STICK, SceneSpec
from lemma.tasks.drags import is_prepared
from lemma.tasks.subtask import Primitive

TABLE = "table"
_ON_M = 0.03
_STACKED_Z_M = 1.2 * CUBE_EDGE_M


@dataclass(frozen=True)
class SymbolicState:
    """A symbolic state with the poses that ground it. Never changed in place."""

    spec: SceneSpec
    poses: dict[str, Pose2]
    """Every object."""
    supports: dict[str, str]
    """What each cube lies on: an entity or the table."""
    labels: dict[str, str]
    """How each movable object got where it is: two ways to one place are one state."""

    @classmethod
    def observe(cls, scene: Scene) -> "SymbolicState":
        """Read the situation off a scene."""
        names = scene.spec.object_names
        poses = {name: scene.pose2(name) for name in names}
        heights = {name: scene.pose(name).position[2] for name in names}
        supports = {
            name: _support(name, poses, heights)
            for name in scene.movable_names
            if name != STICK
        }
        labels = dict.fromkeys(scene.movable_names, "start")
        labels.update({n: f"on {s}" for n, s in supports.items() if s != TABLE})
        return cls(scene.spec, poses, supports, labels)

    @property
    def key(self) -> tuple[tuple[str, str], ...]:
        """What makes two situations the same to the planner."""
        return tuple(sorted(self.labels.items()))

    def on_top_of(self, name: str) -> str | None:
        """Return the cube that lies on an object, if any."""
        for cube, support in self.supports.items():
            if support == name:
                return cube
        return None

    def is_prepared(self, primitive: Primitive, cube: str) -> bool:
        """Whether the stick lies ready to hook or to poke a cube."""
        if STICK not in self.poses:
            return False
        return is_prepared(primitive, self.poses[STICK], self.poses[cube])

    def moved(
        self, name: str, pose: Pose2, support: str, label: str
    ) -> "SymbolicState":
        """Return the situation after an object was moved."""
        supports = self.supports
        if name != STICK:
            supports = {**supports, name: support}
        return replace(
            self,
            poses={**self.poses, name: pose},
            supports=supports,
            labels={**self.labels, name: label},
        )


def _support(name: str, poses: dict[str, Pose2], heights: dict[str, float]) -> str:
    """Return what a cube lies on."""
    if heights[name] > _STACKED_Z_M:
        below = [
            other
            for other in poses
            if other.endswith("_cube")
            and other != name
            and heights[other] < heights[name] - 0.5 * CUBE_EDGE_M
            and poses[other].distance(poses[name]) < _ON_M
        ]
        return max(below, key=lambda other: heights[other], default=TABLE)
    for other in poses:
        near = poses[other].distance(poses[name]) < PAD_RADIUS_M - 0.01
        if other.endswith("_pad") and near:
            return other
    return TABLE
