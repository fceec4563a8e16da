"""Goals: conjunctions of ``On(top, bottom)``, and whether they hold in a scene.

Everything here is a function of where things are and how fast they move, not of what
the engine computed last: it is the same after a step, after a snapshot was restored,
and after something was put elsewhere by hand.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose
from lemma.core.seeding import ordered_sum
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.kind import Point
from lemma.scene.scene import Scene

REST_M_S = 0.01
"""An object at rest is slower than this [m/s]. After a second of rest it moves at less
than a billionth of it."""
REST_RAD_S = 0.1
"""And it turns slower than this [rad/s]."""
TILT_RAD = math.radians(3.0)
"""An object stands on a face that is within this of level [rad]."""
_STEEP = math.cos(math.radians(30.0))
"""A contact carries if its normal is nearer to the vertical than this."""


@dataclass(frozen=True, slots=True)
class On:
    """One thing lies on another: a cube on a pad, or a cube on a cube."""

    top: str
    bottom: str

    def __post_init__(self) -> None:
        """Check that the kinds can be stacked.

        Raises:
            UnknownNameError: No such entity.
            InvalidConfigError: The top is fixed or a tool, nothing can lie on the
                bottom, or they are one thing.
        """
        if not kind_of(self.top).cargo or self.top == self.bottom:
            raise InvalidConfigError(
                f"On({self.top!r}, {self.bottom!r}): the top must be something that "
                "can be put somewhere, such as a cube, and not the bottom itself."
            )
        if kind_of(self.bottom).support_m is None:
            raise InvalidConfigError(
                f"On({self.top!r}, {self.bottom!r}): nothing can lie on the bottom; it "
                "must be a cube, a pad or another kind with support_m."
            )

    def holds(self, scene: Scene) -> bool:
        """Whether it is true now.

        The bottom alone carries the top: they touch, and nothing else touches the top
        but what lies on it. Both are at rest and level, on the table and not below it,
        and no robot touches either. The top's middle is no farther from the bottom's
        than the bottom's kind allows: on a pad at least 1 cm inside its edge, on a cube
        above its top face.
        """
        # From cheap to dear: this is asked at every step.
        return (
            self._is_above(scene)
            and all(is_at_rest(scene, name) for name in (self.top, self.bottom))
            and all(_stands_on_a_face(scene, name) for name in (self.top, self.bottom))
            and not {self.top, self.bottom} & set(scene.fallen)
            and _carries_alone(scene, self.bottom, self.top)
        )

    def _is_above(self, scene: Scene) -> bool:
        """Whether the top's middle is over the part of the bottom that may carry it."""
        limit = kind_of(self.bottom).support_m
        assert limit is not None
        top, bottom = scene.position(self.top), scene.position(self.bottom)
        dx, dy = top[0] - bottom[0], top[1] - bottom[1]
        return dx * dx + dy * dy <= limit * limit and top[2] > bottom[2]


@dataclass(frozen=True, slots=True)
class Goal:
    """Several ``On`` that shall hold at once."""

    conjuncts: tuple[On, ...]

    def __post_init__(self) -> None:
        """Check that it asks for something.

        Raises:
            InvalidConfigError: It has no conjuncts.
        """
        if not self.conjuncts:
            raise InvalidConfigError(
                "A goal without On(top, bottom) asks for nothing. Give at least one."
            )

    @classmethod
    def from_pairs(cls, pairs: tuple[tuple[str, str], ...]) -> Self:
        """Make a goal from (top, bottom) pairs."""
        return cls(tuple(On(top, bottom) for top, bottom in pairs))

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The (top, bottom) pairs."""
        return tuple((on.top, on.bottom) for on in self.conjuncts)

    @property
    def entities(self) -> tuple[str, ...]:
        """Every object that the goal speaks of, each once."""
        return tuple(dict.fromkeys(name for pair in self.pairs for name in pair))

    def progress(self, scene: Scene) -> float:
        """Return the fraction of conjuncts that hold, in [0, 1]."""
        held = [on.holds(scene) for on in self.conjuncts]
        return held.count(True) / len(held)


def is_at_rest(scene: Scene, name: str) -> bool:
    """Whether an object neither moves nor turns."""
    return scene.speed(name) < REST_M_S and scene.turn_rate(name) < REST_RAD_S


def _stands_on_a_face(scene: Scene, name: str) -> bool:
    """Whether one of the faces that an object may stand on is level, below it."""
    up, least = _upward(scene.pose(name)), math.cos(TILT_RAD)
    return any(
        ordered_sum(a * b for a, b in zip(up, top, strict=True)) >= least
        for top in kind_of(name).tops
    )


def _carries_alone(scene: Scene, bottom: str, top: str) -> bool:
    """Whether an object lies on another one, and nothing else touches it from anywhere.

    Objects on the upper one may touch it from above. No robot may touch
    either of them; a bottom that is fixed to the table may be touched.

    Args:
        scene: Where things are now.
        bottom: Name of the object below.
        top: Name of the movable object above.
    """
    model = scene.model
    lower, upper = (int(model.body(name).id) for name in (bottom, top))
    carried = False
    for first, second, rise in _touching(scene, (upper, lower)):
        entity = scene.entity_of_body(second)
        if first == lower:
            if entity is None and second > 0 and bottom in scene.movable_names:
                return False
        elif second == lower:
            carried = carried or rise <= -_STEEP
        elif entity is None or rise < _STEEP:
            return False
    return carried


def _touching(
    scene: Scene, bodies: tuple[int, ...]
) -> Iterator[tuple[int, int, float]]:
    """Yield who touches some bodies, and how far up from them that is.

    Yields:
        One of the bodies; the body that touches it, 0 for the room; and the vertical
        component of the contact's normal, from the first to the second.
    """
    data = scene.posed(scene.data.qpos)
    mujoco.mj_collision(scene.model, data)
    contact = data.contact
    owners = scene.model.body_rootid[scene.model.geom_bodyid[contact.geom]]
    rises = np.asarray(contact.frame)[:, 2]
    for (one, other), rise in zip(owners.tolist(), rises.tolist(), strict=True):
        if one in bodies:
            yield one, other, rise
        if other in bodies:
            yield other, one, -rise


def _upward(pose: Pose) -> Point:
    """Return where the vertical points in the frame of a pose."""
    w, x, y, z = pose.quaternion
    return (
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
