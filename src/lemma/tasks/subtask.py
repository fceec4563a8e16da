"""Sub-tasks: symbolic ones of a planner, and grounded ones of a grounder."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2


class Primitive(StrEnum):
    """A primitive.

    The members are the paper's six (section IV), two of the ladder and one of teams,
    which action spaces and trained weights number in this order. ``Primitive("push")`` also finds
    what users have added to :data:`lemma.planning.primitives.PRIMITIVES`.
    """

    MOVE = "move"
    """Pick something up and put it down."""
    PREHOOK = "prehook"
    """Put the stick down with its hook behind a cube."""
    HOOK = "hook"
    """Drag the cube with the stick."""
    PREPOKE = "prepoke"
    """Put the stick down with its head before a cube."""
    POKE = "poke"
    """Push the cube with the stick."""
    STOP = "stop"
    """Say that the goal is reached."""
    REACH = "reach"
    """Hold an open hand over something, and stay there."""
    LIFT = "lift"
    """Pick something up, and stay there with it."""
    CARRY = "carry"
    """Carry something by one handle, while another robot has the other one."""

    @classmethod
    def _missing_(cls, value: object) -> "Primitive":
        """Find a primitive that was added.

        Raises:
            UnknownNameError: There is none of that name.
        """
        if value not in _added:
            raise UnknownNameError("primitive", value, primitive_names())
        return _added[str(value)][0]


_added: dict[str, tuple[Primitive, str]] = {}
"""Primitives that users added, and how sub-instructions say them."""


def add_primitive(name: str, phrase: str) -> None:
    """Make a name a primitive; see :data:`lemma.planning.primitives.PRIMITIVES`.

    Args:
        name: A lower-case word.
        phrase: How sub-instructions say it, with slots ``{robot}``, ``{pick}`` and
            ``{place}``.

    Raises:
        InvalidConfigError: The name is no lower-case word, or the phrase has another
            slot.
    """
    if not (name.isidentifier() and name.islower()):
        raise InvalidConfigError(
            f"{name!r} cannot name a primitive. Use a lower-case word, such as 'push'."
        )
    try:
        phrase.format(robot="", pick="", place="")
    except (KeyError, IndexError, ValueError) as error:
        raise InvalidConfigError(
            f"The phrase {phrase!r} of primitive {name!r} cannot be filled: {error}. "
            "Its slots are {robot}, {pick} and {place}."
        ) from None
    if name in _added:
        member = _added[name][0]
    else:
        # As Flag makes its members: equal names are one object, also after pickling.
        member = str.__new__(Primitive, name)
        member._name_, member._value_ = name.upper(), name
    _added[name] = member, phrase


def primitive_names() -> tuple[str, ...]:
    """Return every primitive in the order of their numbers: ours, then users'."""
    return (*(str(primitive) for primitive in Primitive), *_added)


def added_phrase(name: str) -> str | None:
    """Return how a primitive is said that users have added; None for others."""
    return _added[name][1] if name in _added else None


@dataclass(frozen=True, slots=True)
class SubTask:
    """A symbolic sub-task: the paper's d_m with g_m = (e, p, q) and robot gamma_m."""

    robot: str
    """Name of the robot: ``"robot_0"``; empty for ``stop``."""
    primitive: Primitive
    pick: str = ""
    """Entity to grasp; the stick for all primitives but ``move``."""
    place: str = ""
    """Entity to put it on, ``"shared"``, or the cube that the stick acts on; the pick
    itself for ``reach`` and ``lift``."""

    def __post_init__(self) -> None:
        """Take the primitive's name as well, and refuse one that nobody knows."""
        object.__setattr__(self, "primitive", Primitive(self.primitive))

    def __str__(self) -> str:
        """Return one readable line."""
        if self.primitive is Primitive.STOP:
            return "stop"
        return f"{self.robot} {self.primitive} {self.pick} -> {self.place}"

    def to_dict(self) -> dict[str, str]:
        """Return plain data, ready for JSON."""
        return {
            "robot": self.robot,
            "primitive": str(self.primitive),
            "pick": self.pick,
            "place": self.place,
        }

    @classmethod
    def from_dict(cls, data: dict[str, str]) -> "SubTask":
        """Make a sub-task from what :meth:`to_dict` returned."""
        return cls(
            data["robot"], Primitive(data["primitive"]), data["pick"], data["place"]
        )


STOP = SubTask("", Primitive.STOP)
JOINT = (Primitive.CARRY,)
"""Sub-tasks of one robot that take a second one, its partner, as well."""
PAPER_PRIMITIVES = tuple(Primitive)[:6]
"""The six of the paper; heads of trained models have one number for each."""


@dataclass(frozen=True, slots=True)
class GroundedSubTask:
    """A sub-task that a robot can execute: poses of the gripper on the table.

    Both poses are those of the gripper, pointing down: where it closes, and where it is
    when the motion ends. The yaw is the direction of the gripper's x axis, which the
    fingers close across; half a turn makes no difference.
    """

    robot: str
    primitive: Primitive
    pick: Pose2
    place: Pose2

    def __post_init__(self) -> None:
        """Take the primitive's name as well, and refuse one that nobody knows."""
        object.__setattr__(self, "primitive", Primitive(self.primitive))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            "robot": self.robot,
            "primitive": str(self.primitive),
            "pick": [self.pick.x, self.pick.y, self.pick.yaw],
            "place": [self.place.x, self.place.y, self.place.yaw],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "GroundedSubTask":
        """Make a grounded sub-task from what :meth:`to_dict` returned."""
        return cls(
            data["robot"],
            Primitive(data["primitive"]),
            Pose2(*data["pick"]),
            Pose2(*data["place"]),
        )
