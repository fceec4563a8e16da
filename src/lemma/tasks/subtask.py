"""Sub-tasks: what a planner says, and what a grounder adds."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from lemma.core.poses import Pose2


class Primitive(StrEnum):
    """What a robot can do (paper, section IV)."""

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


@dataclass(frozen=True, slots=True)
class SubTask:
    """A symbolic sub-task: the paper's d_m with g_m = (e, p, q) and robot gamma_m."""

    robot: str
    """Who: ``"robot_0"``; empty for ``stop``."""
    primitive: Primitive
    pick: str = ""
    """Entity to grasp; the stick for all primitives but ``move``."""
    place: str = ""
    """Entity to put it on, ``"shared"``, or the cube that the stick acts on."""

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

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            "robot": self.robot,
            "primitive": str(self.primitive),
            "pick": [self.pick.x, self.pick.y, self.pick.yaw],
            "place": [self.place.x, self.place.y, self.place.yaw],
        }
