"""Goals: conjunctions of predicates, and their evaluation in a scene.

``On(top, bottom)`` is about the position of a cube. ``Lifted(item)`` and
``Reached(item)`` are about a gripper; only the first rungs of the ladder use them. Each
predicate has a top and a bottom, either of which may be
:data:`~lemma.scene.objects.entity.HAND`, so a goal can be given as pairs of names.

Predicates are functions of positions and velocities alone, not of other results of the
engine. So they have the same value after a step, after a snapshot was restored, and
after an object was moved by the user.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose, Pose2
from lemma.core.seeding import ordered_sum
from lemma.scene.objects.contacts import LEFT, RIGHT, find_touches
from lemma.scene.objects.entity import HAND, kind_of
from lemma.scene.objects.kind import Point
from lemma.scene.scene import Scene
from lemma.tasks.subtask import SubTask
from lemma.tasks.teams.rule import Has, Rule

REST_M_S = 0.01
"""Largest speed of an object at rest [m/s]. The speed of a resting object decays to
less than a billionth of it within 1 s."""
REST_RAD_S = 0.1
"""Largest angular speed of an object at rest [rad/s]."""
TILT_RAD = math.radians(3.0)
"""Largest tilt of an object that stands on a face [rad]."""
LIFTED_M = 0.05
"""Height above its resting position on the table from which a cube is lifted [m]."""
OVER_M = 0.03
"""Largest horizontal distance of a gripper over an object from its centre [m]."""
HOVER_M = 0.10
"""Largest height of such a gripper above the top of the object [m]."""
NOT_IN_TURNS = (
    "{what} wants two things to be done at the same time, so robots cannot do it in "
    'turns. Let them act together: --acting together, or acting="together".'
)
"""Message about goals that are not reached in turns."""
_STEEP = math.cos(math.radians(30.0))
"""Smallest vertical component of the normal of a contact that supports an object."""


@dataclass(frozen=True, slots=True)
class On:
    """One object lies on another, such as a cube on a pad or on a cube.

    A plank lies on two objects; a goal says this with two of these predicates.
    """

    top: str
    bottom: str

    def __post_init__(self) -> None:
        """Check that the kinds can be stacked.

        Raises:
            UnknownNameError: No such entity.
            InvalidConfigError: The top is fixed or a tool, no object can lie on the
                bottom, or both are the same object.
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
        """Return whether the predicate holds now.

        The bottom alone supports the top (a plank has a second support): they touch,
        and other contacts of the top are only with objects on it. Both are at rest,
        level, and not below the table, and no robot touches either. The distance of the
        centres is at most ``support_m`` of the bottom's kind: on a pad at least 1 cm
        inside its edge, on a cube above its top face. For a plank, it is the distance
        between the bottom's centre and one of the two points that
        :meth:`.ObjectKind.rests` returns.
        """
        # Cheap conditions first, because this runs in every step.
        return (
            self._is_above(scene)
            and all(is_at_rest(scene, name) for name in (self.top, self.bottom))
            and all(_stands_on_a_face(scene, name) for name in (self.top, self.bottom))
            and not {self.top, self.bottom} & set(scene.fallen)
            and _carries_alone(scene, self.bottom, self.top)
        )

    def lies(self, scene: Scene) -> bool:
        """Return whether the top lies on the bottom, possibly tilted or leaning.

        The top's centre is over the supporting part of the bottom, they touch, the top
        is at rest, and no robot touches it. The other conditions of :meth:`holds` may
        become true later without an action.
        """
        if not self._is_above(scene) or not is_at_rest(scene, self.top):
            return False
        model = scene.model
        lower, upper = (int(model.body(name).id) for name in (self.bottom, self.top))
        others = [other for _, other, _ in _touching(scene, (upper,))]
        things = (other == 0 or scene.entity_of_body(other) for other in others)
        return lower in others and all(things)

    def _is_above(self, scene: Scene) -> bool:
        """Return whether the top's centre is over the supporting part of the bottom."""
        top, bottom = scene.position(self.top), scene.position(self.bottom)
        kind, limit = scene.kinds[self.top], scene.kinds[self.bottom].support_m
        assert limit is not None
        if kind.span_m is not None:
            at = Pose2(float(bottom[0]), float(bottom[1]))
            rests = kind.rests(scene.pose2(self.top))
            over = any(rest.distance(at) <= limit for rest in rests)
            return over and bool(top[2] > bottom[2])
        dx, dy = top[0] - bottom[0], top[1] - bottom[1]
        return dx * dx + dy * dy <= limit * limit and top[2] > bottom[2]


@dataclass(frozen=True, slots=True)
class Lifted:
    """A gripper holds an object above the table."""

    top: str
    bottom: str = HAND

    def __post_init__(self) -> None:
        """Check that a gripper can hold it.

        Raises:
            UnknownNameError: No such entity.
            InvalidConfigError: No gripper can hold it.
        """
        if kind_of(self.top).grasp is None:
            raise InvalidConfigError(f"No gripper can hold the {self.top}.")

    def holds(self, scene: Scene) -> bool:
        """Return whether the predicate holds now.

        Both fingers of one gripper touch the object, nothing but that robot touches it,
        and it is :data:`LIFTED_M` higher than upright on the table.
        """
        height_m = scene.position(self.top)[2] - kind_of(self.top).origin_m
        return height_m >= LIFTED_M and _hangs_in_a_hand(scene, self.top)


@dataclass(frozen=True, slots=True)
class Reached:
    """A gripper is over an object without touching it."""

    bottom: str
    top: str = HAND

    def __post_init__(self) -> None:
        """Check that there is such an entity.

        Raises:
            UnknownNameError: No such entity.
        """
        kind_of(self.bottom)

    def holds(self, scene: Scene) -> bool:
        """Return whether the predicate holds now.

        A tool centre point is within a horizontal distance of :data:`OVER_M` from the
        object's centre, and above the object's top by :data:`HOVER_M` at most. The
        object is at rest, not below the table, and no robot touches it.
        """
        if self.bottom in scene.fallen or not is_at_rest(scene, self.bottom):
            return False
        data = scene.posed(scene.data.qpos)
        off = data.site_xpos[scene.tcp_sites] - scene.position(self.bottom)
        above_m = off[:, 2] - kind_of(self.bottom).top_m
        near = off[:, 0] ** 2 + off[:, 1] ** 2 <= OVER_M**2
        if not (near & (above_m >= 0.0) & (above_m <= HOVER_M)).any():
            return False
        body = int(scene.model.body(self.bottom).id)
        return all(
            scene.entity_of_body(other) is not None or other == 0
            for _, other, _ in _touching(scene, (body,))
        )


Predicate = On | Lifted | Reached


@dataclass(frozen=True, slots=True)
class Goal:
    """Predicates that must hold at the same time, with an optional rule."""

    conjuncts: tuple[Predicate, ...]
    rule: Rule | None = None
    """A constraint on the sub-tasks; see :mod:`lemma.tasks.teams.rule`."""

    def __post_init__(self) -> None:
        """Check conjuncts and rule.

        Raises:
            InvalidConfigError: There are no conjuncts, or the rule is about others.
        """
        if not self.conjuncts:
            raise InvalidConfigError(
                "A goal needs at least one predicate, such as On(top, bottom)."
            )
        placed = [(on.top, on.bottom) for on in self.placements]
        if self.rule is not None and not set(self.rule.pairs) <= set(placed):
            raise InvalidConfigError(
                f"{self.rule} is about On{self.rule.pairs}, but the goal has {placed}."
            )

    @classmethod
    def from_pairs(
        cls, pairs: tuple[tuple[str, str], ...], rule: Rule | None = None
    ) -> Self:
        """Create a goal from (top, bottom) pairs; either may be ``"hand"``.

        Args:
            pairs: Names of entities.
            rule: The rule, if any.

        Raises:
            UnknownNameError: No such entity.
            InvalidConfigError: A pair is no predicate, or the rule is about others.
        """

        def predicate(top: str, bottom: str) -> Predicate:
            if top == HAND:
                return Reached(bottom)
            return Lifted(top) if bottom == HAND else On(top, bottom)

        return cls(tuple(predicate(top, bottom) for top, bottom in pairs), rule)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The (top, bottom) pairs."""
        return tuple((on.top, on.bottom) for on in self.conjuncts)

    @property
    def entities(self) -> tuple[str, ...]:
        """The objects in the goal, each once."""
        names = (name for pair in self.pairs for name in pair if name != HAND)
        return tuple(dict.fromkeys(names))

    @property
    def placements(self) -> tuple[On, ...]:
        """The conjuncts of type :class:`On`."""
        return tuple(on for on in self.conjuncts if isinstance(on, On))

    @property
    def held(self) -> frozenset[str]:
        """Names of the objects that grippers must hold."""
        return frozenset(on.top for on in self.conjuncts if on.bottom == HAND)

    @property
    def in_turns(self) -> bool:
        """Whether robots that act in turns can reach it; see :attr:`.Rule.in_turns`."""
        return self.rule is None or self.rule.in_turns

    def check_in_turns(self) -> None:
        """Check that robots that act in turns can reach it.

        Raises:
            InvalidConfigError: They cannot; the message says what to do.
        """
        if not self.in_turns:
            raise InvalidConfigError(NOT_IN_TURNS.format(what="This goal"))

    def permits(self, subtask: SubTask, has: Has) -> bool:
        """Return whether the rule permits a sub-task; see :meth:`.Rule.permits`."""
        return self.rule is None or self.rule.permits(subtask, has)

    def progress(self, scene: Scene) -> float:
        """Return the fraction of conjuncts that hold, in [0, 1]."""
        held = [on.holds(scene) for on in self.conjuncts]
        return held.count(True) / len(held)


def is_at_rest(scene: Scene, name: str) -> bool:
    """Return whether an object neither moves nor turns."""
    return scene.speed(name) < REST_M_S and scene.turn_rate(name) < REST_RAD_S


def _stands_on_a_face(scene: Scene, name: str) -> bool:
    """Return whether an object stands level on one of its faces."""
    up, least = _upward(scene.pose(name)), math.cos(TILT_RAD)
    return any(
        ordered_sum(a * b for a, b in zip(up, top, strict=True)) >= least
        for top in kind_of(name).tops
    )


def _carries_alone(scene: Scene, bottom: str, top: str) -> bool:
    """Return whether an object is supported by another one alone.

    Objects on the upper one may touch it from above, and a plank has another object
    below it. Robots must not touch the upper one, and the lower one only if it is fixed
    to the table.

    Args:
        scene: The scene.
        bottom: Name of the object below.
        top: Name of the movable object above.
    """
    model = scene.model
    lower, upper = (int(model.body(name).id) for name in (bottom, top))
    carriers, wanted = set[int](), 1 if kind_of(top).span_m is None else 2
    for first, second, rise in _touching(scene, (upper, lower)):
        entity = scene.entity_of_body(second)
        if first == lower:
            if entity is None and second > 0 and bottom in scene.movable_names:
                return False
        elif second == lower:
            carriers |= {second} if rise <= -_STEEP else set()
        elif wanted > 1 and entity is not None and rise <= -_STEEP:
            carriers.add(second)
        elif entity is None or rise < _STEEP:
            return False
    return lower in carriers and len(carriers) == wanted


def _hangs_in_a_hand(scene: Scene, name: str) -> bool:
    """Return whether one gripper holds an object that touches nothing else."""
    body = int(scene.model.body(name).id)
    robots = set()
    for _, other, _ in _touching(scene, (body,)):
        if other == 0 or scene.entity_of_body(other) is not None:
            return False
        robots.add(other)
    touch = np.zeros((len(scene.robots), len(scene.coasting.names)), np.int64)
    contacts = scene.posed(scene.data.qpos).contact.geom
    find_touches(contacts, scene.coasting.owner, scene.parts, touch)
    pads = touch[:, scene.coasting.names.index(name)] & (LEFT | RIGHT)
    return len(robots) == 1 and LEFT | RIGHT in pads


def _touching(
    scene: Scene, bodies: tuple[int, ...]
) -> Iterator[tuple[int, int, float]]:
    """Yield the contacts of bodies.

    Yields:
        One of the bodies; the body that touches it, 0 for the room; and the vertical
        component of the contact's normal from the first to the second.
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
    """Return the upward unit vector in the frame of a pose."""
    w, x, y, z = pose.quaternion
    return (
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
