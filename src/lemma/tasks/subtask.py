"""Symbolic and grounded sub-tasks."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2


class Primitive(StrEnum):
    """A primitive.

    The members are the paper's six (section IV), two of the ladder and two of teams, in
    the order of their numbers in action spaces and trained weights.
    ``Primitive("push")`` also finds primitives that users have added to
    :data:`lemma.planning.primitives.PRIMITIVES`.
    """

    MOVE = "move"
    """Pick an object up and put it down."""
    PREHOOK = "prehook"
    """Put the stick down with its hook behind a cube."""
    HOOK = "hook"
    """Drag the cube with the stick."""
    PREPOKE = "prepoke"
    """Put the stick down with its head in front of a cube."""
    POKE = "poke"
    """Push the cube with the stick."""
    STOP = "stop"
    """Declare that the goal is reached."""
    REACH = "reach"
    """Hold the open gripper over an object, and stay there."""
    LIFT = "lift"
    """Pick an object up, and stay there with it."""
    CARRY = "carry"
    """Carry an object by one handle, while a second robot holds the other handle."""
    GIVE = "give"
    """Hand an object by its end to a second robot in the air, which puts it down."""

    @classmethod
    def _missing_(cls, value: object) -> "Primitive":
        """Return an added primitive.

        Raises:
            UnknownNameError: No such primitive.
        """
        if value not in _added:
            raise UnknownNameError("primitive", value, primitive_names())
        return _added[str(value)][0]


_added: dict[str, tuple[Primitive, str]] = {}
"""Primitives that users added, with their phrases in sub-instructions."""


def add_primitive(name: str, phrase: str) -> None:
    """Add a primitive; see :data:`lemma.planning.primitives.PRIMITIVES`.

    Args:
        name: A lower-case word.
        phrase: Its sub-instruction, with slots ``{robot}``, ``{pick}`` and ``{place}``.

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
        # Like enum.Flag, so that equal names are one object, also after pickling.
        member = str.__new__(Primitive, name)
        member._name_, member._value_ = name.upper(), name
    _added[name] = member, phrase


def primitive_names() -> tuple[str, ...]:
    """Return the names of all primitives in the order of their numbers."""
    return (*(str(primitive) for primitive in Primitive), *_added)


def added_phrase(name: str) -> str | None:
    """Return the phrase of a primitive that users have added; None for others."""
    return _added[name][1] if name in _added else None


@dataclass(frozen=True, slots=True)
class SubTask:
    """A symbolic sub-task: the paper's d_m with g_m = (e, p, q) and robot gamma_m.

    Raises:
        UnknownNameError: No such primitive.
    """

    robot: str
    """Name of the robot, such as ``"robot_0"``; empty for ``stop``."""
    primitive: Primitive
    pick: str = ""
    """Entity to grasp: the stick for the four primitives of the tool."""
    place: str = ""
    """Entity or region to put it on, or the cube that the stick acts on; equal to
    ``pick`` for ``reach`` and ``lift``."""

    def __post_init__(self) -> None:
        """Convert a name to a primitive."""
        object.__setattr__(self, "primitive", Primitive(self.primitive))

    def __str__(self) -> str:
        """Return a readable line."""
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
        """Create a sub-task from the result of :meth:`to_dict`."""
        return cls(
            data["robot"], Primitive(data["primitive"]), data["pick"], data["place"]
        )


STOP = SubTask("", Primitive.STOP)
JOINT = (Primitive.CARRY, Primitive.GIVE)
"""Sub-tasks of one robot that take a second one, its partner, as well."""
PAPER_PRIMITIVES = tuple(Primitive)[:6]
"""The paper's six; heads of trained models have one output for each."""


@dataclass(frozen=True, slots=True)
class GroundedSubTask:
    """A sub-task that a robot can execute, with poses of the gripper.

    Both poses are world from gripper, pointing down: at the grasp, and at the end of
    the motion. The yaw is the direction of the gripper's x axis; the fingers close
    across it, so yaws that differ by pi are equivalent.

    Raises:
        UnknownNameError: No such primitive.
    """

    robot: str
    primitive: Primitive
    pick: Pose2
    place: Pose2

    def __post_init__(self) -> None:
        """Convert a name to a primitive."""
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
        """Create a grounded sub-task from the result of :meth:`to_dict`."""
        return cls(
            data["robot"],
            Primitive(data["primitive"]),
            Pose2(*data["pick"]),
            Pose2(*data["place"]),
        )
