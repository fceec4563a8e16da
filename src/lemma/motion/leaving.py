"""Places that another robot has yet to clear: an arm waits with its load until then.

Sub-tasks are chosen for the state after all running sub-tasks. So the place of a new
sub-task may still be occupied by an object that another robot is about to remove.
Without waiting, an arm that arrives first would put its load on top of that object.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from lemma.core.poses import Pose2
from lemma.motion.arm_motion import ArmMotion, largest_turn
from lemma.motion.moves import Motion
from lemma.motion.reservations import Reservations
from lemma.motion.staying import HOME_RAD
from lemma.scene.objects.entity import kind_of

NOTHING_LEAVES: Final[Mapping[str, str]] = MappingProxyType({})
ROOM_M = 0.06
"""An object occupies a place if its centre is nearer to it than this [m]."""
_LYING_M = 0.03
"""An object lies on the table if it is less than this above its resting height [m]."""


class Leaving:
    """Objects that busy robots remove, by the robot that needs their place."""

    def __init__(
        self, arms: Mapping[str, ArmMotion], reservations: Reservations
    ) -> None:
        """Start without such places.

        Args:
            arms: Motion of every robot of the scene, by robot name.
            reservations: Reservations of the same arms.
        """
        self._scene = next(iter(arms.values())).scene
        self._reservations = reservations
        self._takers: dict[str, Mapping[str, str]] = {}

    def note(self, robot: str, takers: Mapping[str, str]) -> None:
        """Set the objects that must be gone before a robot puts its load down.

        Args:
            robot: The robot that begins a sub-task.
            takers: For each such object, the robot that removes it.
        """
        self._takers[robot] = takers

    def is_occupied(self, robot: str, place: Pose2) -> bool:
        """Return whether an object still lies at a place and its remover is busy."""
        return any(
            self._reservations.is_at_work(taker) and self._lies(thing, place)
            for thing, taker in self._takers.get(robot, {}).items()
        )

    def _lies(self, thing: str, place: Pose2) -> bool:
        x, y, z = self._scene.position(thing)
        away = place.distance(Pose2(float(x), float(y)))
        return away < ROOM_M and z - kind_of(thing).origin_m < _LYING_M

    def wait_at_home(self, arm: ArmMotion, place: Pose2) -> Motion:
        """Go home with the held object, and wait there until a place is free."""
        name = arm.robot.name
        self._reservations.ask_for_home(name)
        arm.follow_posture(arm.park)
        while largest_turn(arm.measured, arm.park) >= HOME_RAD:
            yield
        self._reservations.give_up(name)
        while self.is_occupied(name, place):
            yield
