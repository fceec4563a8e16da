"""Places that others have yet to clear: an arm keeps its load until they have.

Orders are given for the state that all that is under way will leave behind. So a place
may be chosen where a thing lies still, which another robot is about to take away. If
that robot is late, an arm that got there first would put its load on top.
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
"""A thing is in the way if its middle is nearer than this to where a load goes [m]."""
_LYING_M = 0.03
"""It still lies there if it is no higher than this over where it lay [m]."""


class Leaving:
    """Things that robots at work take away, by the robot that needs their place."""

    def __init__(
        self, arms: Mapping[str, ArmMotion], reservations: Reservations
    ) -> None:
        """Let everybody put things wherever they are told.

        Args:
            arms: Motion of every robot of the scene, by robot name.
            reservations: Of the same arms.
        """
        self._scene = next(iter(arms.values())).scene
        self._reservations = reservations
        self._takers: dict[str, Mapping[str, str]] = {}

    def note(self, robot: str, takers: Mapping[str, str]) -> None:
        """Note what must be gone before a robot puts its load down.

        Args:
            robot: Which begins a sub-task.
            takers: The robot that takes each thing away, by the thing.
        """
        self._takers[robot] = takers

    def is_occupied(self, robot: str, place: Pose2) -> bool:
        """Whether a thing lies at a place still, and its taker is at work."""
        return any(
            self._reservations.is_at_work(taker) and self._lies(thing, place)
            for thing, taker in self._takers.get(robot, {}).items()
        )

    def _lies(self, thing: str, place: Pose2) -> bool:
        x, y, z = self._scene.position(thing)
        away = place.distance(Pose2(float(x), float(y)))
        return away < ROOM_M and z - kind_of(thing).origin_m < _LYING_M

    def wait_at_home(self, arm: ArmMotion, place: Pose2) -> Motion:
        """Take home what an arm holds, and wait there until a place is free."""
        name = arm.robot.name
        self._reservations.ask_for_home(name)
        arm.follow_posture(arm.park)
        while largest_turn(arm.measured, arm.park) >= HOME_RAD:
            yield
        self._reservations.give_up(name)
        while self.is_occupied(name, place):
            yield
