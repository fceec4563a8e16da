"""Arms of free robots that are not parked: each holds the sector in which it stays.

``reach`` and ``lift`` end over the table. An arm that stays there reserves its way
home. If another arm waits for that sector, the arm makes way after
:data:`~.reservations.PATIENCE_S`: it rises and goes home with its load. Its robot is
free meanwhile; a new sub-task begins from the arm's present position.
"""

from collections.abc import Mapping

from lemma.core.poses import Pose2
from lemma.motion.arm_motion import ArmMotion, largest_turn
from lemma.motion.moves import Motion, Moves
from lemma.motion.obstacles import Obstacles
from lemma.motion.reservations import PATIENCE_S, Reservations
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.scene.objects.entity import STICK

HOME_RAD = 0.05
"""An arm is at home if no joint is farther than this from its park posture [rad]."""


class StayingArms:
    """The arms of one scene that are free but not at home, while others are busy."""

    def __init__(
        self,
        arms: Mapping[str, ArmMotion],
        reservations: Reservations,
        obstacles: Obstacles,
    ) -> None:
        """Start without staying arms.

        Args:
            arms: Motion of every robot of the scene, by robot name.
            reservations: Reservations of the same arms.
            obstacles: Obstacles of the same arms.
        """
        self._arms, self._reservations = arms, reservations
        self._obstacles = obstacles
        self._scene = next(iter(arms.values())).scene
        self._ways: dict[str, Motion | None] = {}

    def __bool__(self) -> bool:
        """Return whether any arm stays."""
        return bool(self._ways)

    def is_home(self, robot: str) -> bool:
        """Return whether an arm is in its park posture."""
        arm = self._arms[robot]
        return largest_turn(arm.measured, arm.park) < HOME_RAD

    def begin(self) -> None:
        """Reserve the sectors of all arms that are not at home; no robot is busy."""
        for robot, arm in self._arms.items():
            if not self.is_home(robot):
                # Decide without contacts, so that a restored state gives the same.
                stick = STICK in self._scene.object_names and Moves(arm).is_full()
                self._reservations.stay(robot, stick=stick)
                self._ways[robot] = None

    def leave(self, robot: str) -> None:
        """Register a robot that became free; reserve a sector if it is not at home."""
        if self.is_home(robot):
            self._reservations.release(robot)
        else:
            self._reservations.stay(robot)
            self._ways[robot] = None

    def work(self, robot: str) -> None:
        """Remove a robot that begins a sub-task from its present position."""
        way = self._ways.pop(robot, None)
        if way is not None:
            way.close()

    def clear(self) -> None:
        """Stop all staying arms where they are, and release their sectors."""
        for robot, way in self._ways.items():
            if way is not None:
                way.close()
                self._arms[robot].sync()
                self._arms[robot].hold()
            self._reservations.release(robot)
        self._ways.clear()

    def make_way(self) -> tuple[str, ...]:
        """Move home the arms that others wait for; return the robots that move."""
        now_s = self._scene.time_s
        for wait in self._reservations.waits.values():
            for robot in wait.holders if now_s - wait.since_s >= PATIENCE_S else ():
                if robot in self._ways and self._ways[robot] is None:
                    self._ways[robot] = self.go_home(self._arms[robot])
        moving = []
        for robot, way in tuple(self._ways.items()):
            if way is not None:
                try:
                    next(way)
                except StopIteration:
                    self._reservations.release(robot)
                    del self._ways[robot]
                else:
                    moving.append(robot)
        return tuple(moving)

    def go_home(self, arm: ArmMotion) -> Motion:
        """Raise the arm, and go home with the held object."""
        self._reservations.ask_for_home(arm.robot.name)
        held = self._scene.held().get(arm.robot.name)
        x, y = arm.tcp_pose()[:2, 3].tolist()
        # An object below the gripper is no obstacle while it rises.
        for _ in Moves(arm).rise_from_here(TRAVEL_HEIGHT_M):
            self._obstacles.feel(arm, Pose2(x, y), held)
            yield
        arm.follow_posture(arm.park)
        while not self.is_home(arm.robot.name):
            self._obstacles.feel(arm, None, held)
            yield
        arm.hold()
