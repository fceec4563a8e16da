"""What a planner that reads is told of a table: as plain data, from the truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from lemma.expert.grounding import GeometricGrounder
from lemma.expert.symbolic_state import SymbolicState
from lemma.policies.interfaces import Oracle, PolicyInput
from lemma.policies.oracle import truth_of
from lemma.robots.reach import reach_of
from lemma.scene.objects.entity import STICK
from lemma.tasks.drags import grasp_on_stick
from lemma.tasks.subtask import Primitive


@dataclass(frozen=True, slots=True)
class RobotText:
    """A robot of the team."""

    name: str
    """``"robot_0"``."""
    phrase: str
    """How people call it: ``"red robot"``."""
    x: float
    """Of its base [m]."""
    y: float
    reach_m: tuple[float, float]
    """Radii around its base between which it grasps and carries [m]."""


@dataclass(frozen=True, slots=True)
class ObjectText:
    """An object of the table."""

    name: str
    x: float
    """Of its middle; of the stick, where it is grasped [m]."""
    y: float
    within: tuple[str, ...]
    """Robots that reach it."""
    state: str = ""
    """What else is known of it: ``"on blue_pad"``."""


@dataclass(frozen=True, slots=True)
class SceneText:
    """A table as a planner reads it."""

    robots: tuple[RobotText, ...]
    objects: tuple[ObjectText, ...]
    lost: tuple[str, ...] = ()
    """What has fallen off."""


class Perception(Protocol):
    """Says what is on the table."""

    def look(self, inputs: Sequence[PolicyInput]) -> list[SceneText]:
        """Return the table of each episode.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@dataclass(frozen=True)
class TruthPerception(Oracle):
    """Oracle perception: everything is where the simulation has it."""

    def look(self, inputs: Sequence[PolicyInput]) -> list[SceneText]:
        """Return the table of each episode.

        Raises:
            InvalidConfigError: The inputs come without the truth.
        """
        return [self._look(given) for given in inputs]

    def _look(self, given: PolicyInput) -> SceneText:
        scene = truth_of(given).simulation.scene
        now, spec = SymbolicState.observe(scene), scene.spec
        geometry = GeometricGrounder(spec)
        robots = []
        for name, phrase, placed in zip(
            spec.robot_names, given.robots, spec.robots, strict=True
        ):
            reach = reach_of(placed.arm)
            radii = reach.inner_m, reach.travel_m
            robots.append(RobotText(name, phrase, placed.base.x, placed.base.y, radii))
        objects = []
        for name, pose in now.poses.items():
            at = grasp_on_stick(pose) if name == STICK else pose
            within = tuple(r for r in spec.robot_names if geometry.reaches(r, at))
            objects.append(ObjectText(name, at.x, at.y, within, _state(name, now)))
        return SceneText(tuple(robots), tuple(objects), now.fallen)


def _state(name: str, now: SymbolicState) -> str:
    """Return what is true of an object besides its place."""
    if name not in now.supports:
        return ""
    told = [f"on the {now.supports[name]}"]
    above = now.on_top_of(name)
    if above is not None:
        told.append(f"under the {above}")
    for use in (Primitive.HOOK, Primitive.POKE):
        if STICK in now.poses and now.is_prepared(use, name):
            told.append(f"the stick lies ready to {use} it")
    return ", ".join(told)
