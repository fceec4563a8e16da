"""One attempt of an attack at an instance: the common base of both levels."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.robots.reach import reach_of
from lemma.scene.objects.entity import kind_of

T = TypeVar("T")


class GiveUp(Exception):
    """Geometry rules out success with this robot, so it makes no further attempt."""


class AttemptOver(Exception):
    """The goal is reached, or the time is up. Attacks do not catch it."""


class Lost(AttemptOver):
    """Something that the goal needs has fallen off the table, or was thrown."""


class Trial(ABC):
    """The state that an attack sees, and the geometry of the robot that acts."""

    def __init__(
        self, episode: Episode, robot: str, rng: np.random.Generator, attempt: int = 0
    ) -> None:
        """Begin an attempt.

        Args:
            episode: An episode in its initial state.
            robot: Name of the robot that acts.
            rng: Source of every random draw.
            attempt: Number of the attempt, from 0.
        """
        self.episode = episode
        self.instance = episode.instance
        self.goal = episode.instance.goal
        self.scene = episode.simulation.scene
        self.robot = robot
        self.rng = rng
        self.attempt = attempt
        self.number = self.scene.spec.robot_names.index(robot)
        self.placement = self.scene.spec.robots[self.number]
        self.reach = reach_of(self.placement.arm)
        self.acted = False
        """Whether anything was executed, including actions undone later."""
        self.best_progress = 0.0
        """Largest share of the goal that held at any time, in [0, 1]."""
        self.simulated_s = 0.0
        """Simulated time of all actions, including those undone later [s]."""
        self.limit_s = math.inf
        """Simulated time after which the attempt is over [s]."""

    @abstractmethod
    def snapshot(self) -> Any:
        """Return the present moment, for :meth:`restore`."""

    @abstractmethod
    def restore(self, moment: Any) -> None:
        """Return to a moment and undo all later actions."""

    @abstractmethod
    def finish(self) -> bool:
        """End the attempt, and return whether the episode is a success."""

    @abstractmethod
    def record(self) -> dict[str, Any]:
        """Return the executed actions, as fields of :class:`.run.Found`."""

    def require(self, possible: object) -> None:
        """Give up unless geometry allows it.

        Use it only where failure is certain; when in doubt, let the attack act.

        Raises:
            GiveUp: ``possible`` is false.
        """
        if not possible:
            raise GiveUp

    def try_each(self, options: Iterable[T], play: Callable[[T], object]) -> None:
        """Try options one after the other, each from the present moment."""
        ready = self.snapshot()
        for option in options:
            self.restore(ready)
            with suppress(Lost):
                play(option)

    def require_near(self, name: str, limit_m: float) -> None:
        """Give up if an object is farther from the robot's base than a limit."""
        self.require(self.radius(self.pose(name)) <= limit_m)

    def pose(self, name: str) -> Pose2:
        """Return the pose of an object, seen from above."""
        return self.scene.pose2(name)

    def radius(self, pose: Pose2) -> float:
        """Return the distance of a position from the robot's base [m]."""
        return self.placement.base.distance(pose)

    def margin(self, pose: Pose2) -> float:
        """Return the distance of a position inside the reach [m]; negative outside."""
        return self.reach.margin(self.placement.base, pose.x, pose.y)

    def outward(self, pose: Pose2) -> float:
        """Return the direction from the robot's base to a position [rad]."""
        base = self.placement.base
        return math.atan2(pose.y - base.y, pose.x - base.x)

    def at(self, radius_m: float, bearing: float) -> Pose2:
        """Return the pose at a distance from the base, facing away from it.

        Args:
            radius_m: Distance [m].
            bearing: Direction from the base in the world's frame [rad].
        """
        base = self.placement.base
        x = base.x + radius_m * math.cos(bearing)
        return Pose2(x, base.y + radius_m * math.sin(bearing), bearing)

    def support_m(self, name: str) -> float:
        """Return the radius around an object's middle in which it carries others [m].

        It is 0 if the object carries none.
        """
        return kind_of(name).support_m or 0.0

    def cargo(self) -> list[str]:
        """Return the movable objects that are no tools and have not fallen."""
        fallen = self.scene.fallen
        names = self.scene.movable_names
        return [n for n in names if kind_of(n).cargo and n not in fallen]

    def spare(self) -> list[str]:
        """Return the cargo that the goal does not need."""
        return [name for name in self.cargo() if name not in self.goal.entities]

    def look(self, is_over: bool) -> None:
        """Update the best progress after an action.

        Raises:
            AttemptOver: The episode is over, or the simulated time is spent.
            Lost: The goal cannot be reached any more, or something was thrown.
        """
        if self.episode.is_thrown:
            # A throw does not count, even if the goal holds where the object lands.
            raise Lost
        self.best_progress = max(self.best_progress, self.episode.goal_progress)
        if is_over:
            raise AttemptOver
        if self.simulated_s >= self.limit_s:
            raise AttemptOver
        if not set(self.episode.fallen).isdisjoint(self.goal.entities):
            raise Lost
