"""State of the symbolic planner: poses and supports of objects."""

import math
from dataclasses import dataclass, field, replace

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
_LEVEL_M = 0.01
"""Two objects support a plank if the heights of their tops differ by less than this."""
_SPAN_SLACK_M = 0.02
"""Largest difference between their distance and the plank's ``span_m``."""
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
    seconds: dict[str, str] = field(default_factory=dict)
    """The second support of each plank that lies on two objects."""

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
        seconds = {}
        for name in supports:
            posts = _posts(name, poses, heights)
            if len(posts) == 2:
                supports[name], seconds[name] = posts
        labels.update({n: f"on {s}" for n, s in supports.items() if s != TABLE})
        labels.update({n: across_label(supports[n], s) for n, s in seconds.items()})
        return cls(scene.spec, poses, supports, labels, fallen, seconds)

    @property
    def key(self) -> tuple[tuple[str, str], ...]:
        """Key by which the planner compares states."""
        return tuple(sorted(self.labels.items()))

    def has(self, top: str, bottom: str) -> bool:
        """Return whether a pair of a goal holds; either of it may be ``"hand"``."""
        return bottom in (self.supports.get(top), self.seconds.get(top))

    def on_top_of(self, name: str) -> str | None:
        """Return the object that lies on an object, or None."""
        for cube, support in self.supports.items():
            if name in (support, self.seconds.get(cube)):
                return cube
        return None

    def across(self, item: str, place: str) -> tuple[Pose2, str, str] | None:
        """Return where a plank lies across a thing and another one of its height.

        Args:
            item: The plank.
            place: The thing.

        Returns:
            Its pose, and the two things by name; None where there is no other one
            with nothing on it, as far from it as the plank spans.
        """
        span_m = kind_of(item).span_m
        if span_m is None or place not in self.poses or not self._may_carry(place):
            return None
        place_m = self._top_m(place)
        one, best_m, other = self.poses[place], _SPAN_SLACK_M, None
        for name, pose in self.poses.items():
            off_m = abs(one.distance(pose) - span_m)
            level = abs(self._top_m(name) - place_m) < _LEVEL_M
            if level and off_m < best_m and self._may_carry(name):
                best_m, other = off_m, name
        if other is None:
            return None
        first, second = sorted((place, other))
        a, b = self.poses[first], self.poses[second]
        yaw = math.atan2(b.y - a.y, b.x - a.x)
        return Pose2(0.5 * (a.x + b.x), 0.5 * (a.y + b.y), yaw), first, second

    def _may_carry(self, name: str) -> bool:
        """Whether something can be put on an object, and nothing lies there."""
        return kind_of(name).support_m is not None and self.on_top_of(name) is None

    def _top_m(self, name: str) -> float:
        """Return how high the top of an object is, by what it stands on [m]."""
        height_m, below = kind_of(name).height_m, self.supports.get(name)
        if below is None or below not in self.poses:
            return height_m
        return height_m + self._top_m(below)

    def is_prepared(self, primitive: Primitive, cube: str) -> bool:
        """Return whether the stick is prepared to hook or poke a cube."""
        if STICK not in self.poses:
            return False
        stick, pose = self.poses[STICK], self.poses[cube]
        return is_prepared(primitive, stick, pose, kind_of(cube))

    def moved(
        self,
        name: str,
        pose: Pose2,
        support: str,
        label: str,
        second: str | None = None,
    ) -> "SymbolicState":
        """Return the state after an object was moved.

        Args:
            name: The object.
            pose: Its new pose.
            support: Its new support.
            label: The new label of its place.
            second: The second support of a plank.
        """
        supports, seconds = self.supports, self.seconds
        if name in supports:
            supports = {**supports, name: support}
        if second is not None or name in seconds:
            seconds = {other: on for other, on in seconds.items() if other != name}
            seconds |= {} if second is None else {name: second}
        return replace(
            self,
            poses={**self.poses, name: pose},
            supports=supports,
            seconds=seconds,
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


def across_label(one: str, other: str) -> str:
    """Return the label of a plank on two things."""
    return f"on {one} and {other}"


def _posts(
    name: str, poses: dict[str, Pose2], heights: dict[str, float]
) -> tuple[str, ...]:
    """Return the two things that an object lies across, by name; none of others."""
    kind = kind_of(name)
    if kind.span_m is None:
        return ()
    found, bottom = set[str](), heights[name] - kind.origin_m
    for rest in kind.rests(poses[name]):
        for other, pose in poses.items():
            support = kind_of(other).support_m if other != name else None
            top = heights[other] + kind_of(other).top_m
            if support is not None and abs(top - bottom) < _LEVEL_M:
                found |= {other} if rest.distance(pose) < max(_ON_M, support) else set()
    return tuple(sorted(found)) if len(found) == 2 else ()


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
