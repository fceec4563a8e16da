"""State of the symbolic planner: poses and supports of objects."""

from dataclasses import dataclass, replace

from lemma.core.poses import Pose2
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.scene import Scene
from lemma.scene.spec import SceneSpec
from lemma.tasks.drags import is_prepared
from lemma.tasks.subtask import Primitive

TABLE = "table"
_ON_M = 0.03
"""An object lies on another if their centres are no farther apart than this, or than
``support_m`` of the lower one's kind if that is larger."""
_LIFTED_M = 0.025
"""If an object's bottom is higher than this, its support is an object whose top is also
higher, such as a pad or a cube; otherwise the table or a thin mat."""


@dataclass(frozen=True)
class SymbolicState:
    """A symbolic state with the poses of objects. It is never changed in place."""

    spec: SceneSpec
    poses: dict[str, Pose2]
    """Pose of each object on the table."""
    supports: dict[str, str]
    """Support of each movable object except the tool: an entity or the table. After
    ``lift`` the support is ``"hand"``; after ``reach``, ``"hand"`` has the object below
    it as support."""
    labels: dict[str, str]
    """A label of each movable object's place: states with equal labels are equal."""
    fallen: tuple[str, ...] = ()
    """Objects that have fallen off the table; no other field contains them."""

    @classmethod
    def observe(cls, scene: Scene) -> "SymbolicState":
        """Return the present symbolic state of a scene."""
        fallen = scene.fallen
        names = [name for name in scene.object_names if name not in fallen]
        poses = {name: scene.pose2(name) for name in names}
        heights = {name: scene.pose(name).position[2] for name in names}
        supports = {
            name: _support(name, poses, heights)
            for name in scene.movable_names
            if kind_of(name).cargo and name not in fallen
        }
        movable = (name for name in scene.movable_names if name not in fallen)
        labels = dict.fromkeys(movable, "start")
        labels.update({n: f"on {s}" for n, s in supports.items() if s != TABLE})
        return cls(scene.spec, poses, supports, labels, fallen)

    @property
    def key(self) -> tuple[tuple[str, str], ...]:
        """Key by which the planner compares states."""
        return tuple(sorted(self.labels.items()))

    def has(self, top: str, bottom: str) -> bool:
        """Return whether a pair of a goal holds; either of it may be ``"hand"``."""
        return self.supports.get(top) == bottom

    def on_top_of(self, name: str) -> str | None:
        """Return the object that lies on an object, or None."""
        for cube, support in self.supports.items():
            if support == name:
                return cube
        return None

    def is_prepared(self, primitive: Primitive, cube: str) -> bool:
        """Return whether the stick is prepared to hook or poke a cube."""
        if STICK not in self.poses:
            return False
        stick, pose = self.poses[STICK], self.poses[cube]
        return is_prepared(primitive, stick, pose, kind_of(cube))

    def moved(
        self, name: str, pose: Pose2, support: str, label: str
    ) -> "SymbolicState":
        """Return the state after an object was moved.

        Args:
            name: The object.
            pose: Its new pose.
            support: Its new support.
            label: The new label of its place.
        """
        supports = self.supports
        if name in supports:
            supports = {**supports, name: support}
        return replace(
            self,
            poses={**self.poses, name: pose},
            supports=supports,
            labels={**self.labels, name: label},
        )


def _support(name: str, poses: dict[str, Pose2], heights: dict[str, float]) -> str:
    """Return the support of an object."""
    bottom = heights[name] - kind_of(name).origin_m
    below = [
        other
        for other in poses
        if other != name and _is_below(other, poses, heights, bottom, poses[name])
    ]
    # In a stack, the highest object below; among equally high ones, the first.
    return max(below, key=lambda other: heights[other], default=TABLE)


def _is_below(
    name: str,
    poses: dict[str, Pose2],
    heights: dict[str, float],
    bottom: float,
    above: Pose2,
) -> bool:
    """Return whether an object supports another with given bottom [m] and centre."""
    kind = kind_of(name)
    lifted, tall = bottom > _LIFTED_M, heights[name] + kind.top_m > _LIFTED_M
    if kind.support_m is None or lifted != tall or (lifted and heights[name] >= bottom):
        return False
    return poses[name].distance(above) < max(_ON_M, kind.support_m)
