"""Deliberate mistakes, executed in place of the expert's sub-task.

Perfect demonstrations do not contain the states after a missed grasp, a misplaced cube
or stick, or a sub-task of the wrong robot. This module causes such mistakes; the expert
then recovers from them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.primitives import PRIMITIVES
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import STICK
from lemma.scene.spec import SceneSpec
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

NONE = "none"
KINDS = ("pick", "place", "drop", "robot", "choice")
"""Kinds of mistakes. ``pick``, ``place``: the pose has an error of centimetres and tens
of degrees; ``drop``: the object is put down halfway; ``robot``: another robot tries the
sub-task, feasible or not; ``choice``: another feasible sub-task, executed correctly."""
_SHARES = (0.20, 0.25, 0.15, 0.15, 0.25)

PICK_OFF_M = (0.01, 0.045)
"""Smallest and largest error of a grasp; an error above half a cube is a miss."""
PLACE_OFF_M = (0.03, 0.12)
"""Smallest and largest error of a placement; an error above the radius of a pad puts
the object beside the pad."""
YAW_OFF_RAD = math.radians(40.0)
_HALFWAY = (0.2, 0.8)
_NEAR = 0.5
"""Probability that another sub-task is as similar as possible to the expert's, such as
with a single different field."""


@dataclass(frozen=True, slots=True)
class Perturbation:
    """Probability and seed of mistakes.

    Raises:
        InvalidConfigError: The probability is not above 0 and at most 1.
    """

    probability: float
    """Probability of a mistake in each sub-task, above 0, at most 1."""
    seed: int = 0
    """Seed of the mistakes; other seeds give other mistakes in the same instances."""

    def __post_init__(self) -> None:
        """Check the probability."""
        if not 0.0 < self.probability <= 1.0:
            raise InvalidConfigError(
                f"The probability of mistakes must be above 0 and at most 1, not "
                f"{self.probability:g}. Try 0.3."
            )


@dataclass(frozen=True, slots=True)
class Mistake:
    """A sub-task that is executed in place of the expert's."""

    kind: str
    """One of :data:`KINDS`."""
    subtask: SubTask
    grounded: GroundedSubTask


class Perturber:
    """Generates mistakes in a scene."""

    def __init__(self, spec: SceneSpec) -> None:
        """Prepare grounding for a scene.

        Args:
            spec: The scene.
        """
        self._grounder = GeometricGrounder(spec)

    def spoil(
        self,
        subtask: SubTask,
        grounded: GroundedSubTask,
        now: SymbolicState,
        rng: np.random.Generator,
    ) -> Mistake:
        """Return a random mistake.

        Args:
            subtask: The expert's sub-task.
            grounded: The same sub-task with poses.
            now: The present state.
            rng: Random generator.
        """
        kind = KINDS[int(rng.choice(len(KINDS), p=_SHARES))]
        found = None
        if kind == "robot":
            found = self._by_another(subtask, grounded, now, rng)
        elif kind == "choice":
            found = self._otherwise(subtask, now, rng)
        if found is not None:
            return found
        kind = kind if kind in ("pick", "drop") else "place"
        return Mistake(kind, subtask, _spoilt(kind, grounded, rng))

    def _by_another(
        self,
        subtask: SubTask,
        grounded: GroundedSubTask,
        now: SymbolicState,
        rng: np.random.Generator,
    ) -> Mistake | None:
        """Return the sub-task of another robot; if infeasible, with the same poses."""
        others = [name for name in self._grounder.robots if name != subtask.robot]
        if not others:
            return None
        robot = others[int(rng.integers(len(others)))]
        theirs = replace(subtask, robot=robot)
        able = self._grounder.ground(theirs, now)
        poses = replace(grounded, robot=robot) if able is None else able.grounded
        return Mistake("robot", theirs, poses)

    def _otherwise(
        self,
        subtask: SubTask,
        now: SymbolicState,
        rng: np.random.Generator,
    ) -> Mistake | None:
        """Return another feasible sub-task; None if there is none."""
        others = [each for each in self._possible(now) if each != subtask]
        others = [others[i] for i in rng.permutation(len(others))]
        if rng.random() < _NEAR:
            others.sort(key=lambda other: _differences(other, subtask))
        for other in others:
            step = self._grounder.ground(other, now)
            if step is not None:
                return Mistake("choice", other, step.grounded)
        return None

    def _possible(self, now: SymbolicState) -> Iterator[SubTask]:
        """Yield the valid sub-tasks, feasible or not."""
        for robot in self._grounder.robots:
            for cube in now.supports:
                for place in (*now.spec.regions, *now.poses):
                    if place not in (cube, STICK, now.supports[cube]):
                        yield SubTask(robot, Primitive.MOVE, cube, place)
            if STICK not in now.poses:
                continue
            for region in now.spec.regions:
                yield SubTask(robot, Primitive.MOVE, STICK, region)
            for cube in now.supports:
                for primitive in Primitive:
                    if PRIMITIVES[primitive].tool:
                        yield SubTask(robot, primitive, STICK, cube)


def _differences(one: SubTask, other: SubTask) -> int:
    """Return the number of fields, of four, in which two sub-tasks differ."""
    first, second = one.to_dict(), other.to_dict()
    return len([word for word in first if first[word] != second[word]])


def _off(pose: Pose2, limits_m: tuple[float, float], rng: np.random.Generator) -> Pose2:
    """Return a pose with a random error: distance within limits, any direction."""
    distance = rng.uniform(*limits_m)
    direction = rng.uniform(-math.pi, math.pi)
    return Pose2(
        pose.x + distance * math.cos(direction),
        pose.y + distance * math.sin(direction),
        pose.yaw + rng.uniform(-YAW_OFF_RAD, YAW_OFF_RAD),
    )


def _spoilt(
    kind: str, grounded: GroundedSubTask, rng: np.random.Generator
) -> GroundedSubTask:
    """Return a sub-task with a wrong pick or place pose."""
    pick, place = grounded.pick, grounded.place
    if kind == "pick":
        return replace(grounded, pick=_off(pick, PICK_OFF_M, rng))
    if kind == "place":
        return replace(grounded, place=_off(place, PLACE_OFF_M, rng))
    # Kind "drop": put the held object down halfway.
    part = rng.uniform(*_HALFWAY)
    x = pick.x + part * (place.x - pick.x)
    y = pick.y + part * (place.y - pick.y)
    return replace(grounded, place=Pose2(x, y, place.yaw))
