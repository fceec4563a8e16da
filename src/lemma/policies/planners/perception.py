"""Scenes as plain data for text planners, from the simulation or from ReachNet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

from lemma.core.robot_names import robot_names
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import Oracle, PolicyInput
from lemma.policies.oracle import truth_of
from lemma.robots.hand import HANDS
from lemma.robots.reach import reach_of
from lemma.scene.objects.entity import SHARED, STICK
from lemma.tasks.drags import grasp_on_stick
from lemma.tasks.subtask import Primitive

if TYPE_CHECKING:
    from lemma.policies.models.reachnet.model import ReachNet
    from lemma.policies.models.reachnet.scene_table import SceneTable

WEIGHTS = "reachnet"
"""Weights of the model for perception and reach."""
_RAISED_M = 0.01


@dataclass(frozen=True, slots=True)
class RobotText:
    """A robot of the team."""

    name: str
    """``"robot_0"``."""
    phrase: str
    """Its phrase in sentences: ``"red robot"``."""
    x: float
    """Position of its base along x [m]."""
    y: float
    reach_m: tuple[float, float]
    """Smallest and largest radius around its base at which it works [m]."""
    carries_kg: float | None = None
    """Largest mass that it carries [kg]; None in a team of standard hands."""


@dataclass(frozen=True, slots=True)
class ObjectText:
    """An object in the scene."""

    name: str
    x: float
    """Position of its center along x; for the stick, of its grasp [m]."""
    y: float
    within: tuple[str, ...]
    """Robots that reach it."""
    state: str = ""
    """Its support and other facts: ``"on blue_pad"``."""
    mass_kg: float | None = None
    """Its mass, where that is not the usual one [kg]."""


@dataclass(frozen=True, slots=True)
class SceneText:
    """A scene as a planner reads it."""

    robots: tuple[RobotText, ...]
    objects: tuple[ObjectText, ...]
    lost: tuple[str, ...] = ()
    """Names of objects that have fallen off the table."""


class Perception(Protocol):
    """Describes scenes."""

    def look(self, inputs: Sequence[PolicyInput]) -> list[SceneText]:
        """Return the scene of each episode.

        Args:
            inputs: One per episode; at least one.
        """
        ...


@dataclass(frozen=True)
class TruthPerception(Oracle):
    """Oracle perception: positions are those of the simulation."""

    def look(self, inputs: Sequence[PolicyInput]) -> list[SceneText]:
        """Return the scene of each episode.

        Raises:
            InvalidConfigError: The inputs are no ``OracleInput``.
        """
        return [self._look(policy_input) for policy_input in inputs]

    def _look(self, policy_input: PolicyInput) -> SceneText:
        scene = truth_of(policy_input).simulation.scene
        now, spec = SymbolicState.observe(scene), scene.spec
        geometry = GeometricGrounder(spec)
        robots = []
        for name, phrase, placed in zip(
            spec.robot_names, policy_input.robots, spec.robots, strict=True
        ):
            reach = reach_of(placed.arm)
            radii = reach.inner_m, reach.travel_m
            most_kg = placed.carries_kg if spec.other_hands else None
            at = placed.base
            robots.append(RobotText(name, phrase, at.x, at.y, radii, most_kg))
        objects = []
        for name, pose in now.poses.items():
            at = grasp_on_stick(pose) if name == STICK else pose
            within = tuple(r for r in spec.robot_names if geometry.reaches(r, at))
            mass_kg, state = spec.placement(name).mass_kg, _state(name, now)
            objects.append(ObjectText(name, at.x, at.y, within, state, mass_kg))
        return SceneText(tuple(robots), tuple(objects), now.fallen)


def _state(name: str, now: SymbolicState) -> str:
    """Return the facts about an object besides its position."""
    if name not in now.supports:
        return ""
    facts = [f"on the {now.supports[name]}"]
    if name in now.seconds:
        facts.append(f"on the {now.seconds[name]}")
    above = now.on_top_of(name)
    if above is not None:
        facts.append(f"under the {above}")
    for use in (Primitive.HOOK, Primitive.POKE):
        if STICK in now.poses and now.is_prepared(use, name):
            facts.append(f"the stick lies ready to {use} it")
    return ", ".join(facts)


class SeenPerception:
    """Perception with ReachNet; hidden objects keep their first visible position."""

    weights = (WEIGHTS,)
    """Published weights that it uses."""

    def __init__(self, model: "ReachNet | None" = None) -> None:
        """Store the model; weights are loaded at the first use.

        Args:
            model: The model for perception; the published one if None.
        """
        self._model = model

    @cached_property
    def model(self) -> "ReachNet":
        """The model for perception."""
        if self._model is not None:
            return self._model
        # torch is an optional dependency, which other planners do not need.
        from lemma.policies.models.reachnet.model import ReachNet  # noqa: PLC0415
        from lemma.policies.weights import load_model  # noqa: PLC0415

        model = load_model(WEIGHTS)
        assert isinstance(model, ReachNet)
        return model

    def look(self, inputs: Sequence[PolicyInput]) -> list[SceneText]:
        """Return the scene of each episode."""
        return [self._look(policy_input) for policy_input in inputs]

    def _look(self, policy_input: PolicyInput) -> SceneText:
        now = self._table(policy_input)
        names = robot_names(len(policy_input.robots))
        robots = []
        for number, (name, phrase) in enumerate(
            zip(names, policy_input.robots, strict=True)
        ):
            x, y = map(_metres, now.bases[0, number].tolist())
            inner, outer, _ = map(_metres, now.radii[0, number].tolist())
            hands = policy_input.hands
            most_kg = HANDS[hands[number]].carries_kg if hands else None
            robots.append(RobotText(name, phrase, x, y, (inner, outer), most_kg))
        objects = _objects(now, names, policy_input)
        if policy_input.past:
            seen = {thing.name for thing in objects}
            first = replace(policy_input, view=policy_input.past[0].view, past=())
            objects += [
                replace(thing, state="hidden now; it was there at first")
                for thing in _objects(self._table(first), names, first)
                if thing.name not in seen
            ]
        return SceneText(tuple(robots), tuple(objects))

    def _table(self, policy_input: PolicyInput) -> "SceneTable":
        """Return the perception of one view.

        Views are not batched, because batching changes last bits, and so prompts.
        """
        from lemma.policies.batch import batch_of  # noqa: PLC0415

        model = self.model
        raster = model.config.raster(policy_input)
        with model.deciding():
            batch = batch_of([policy_input], raster, (), model.device, model.entities)
            marks, coarse = model.eye(batch)
            return model.eye.table(marks, coarse, batch)


def _objects(
    table: "SceneTable", names: tuple[str, ...], policy_input: PolicyInput
) -> list[ObjectText]:
    """Return the perceived objects of one scene."""
    traits = table.traits
    margins = table.margins(table.xy)[0]
    grasp = table.margins(table.grasp[:, None])[0, :, 0]
    found = []
    for number, name in enumerate(table.entities.names):
        if not table.present[0, number]:
            continue
        at = table.xy[0, number]
        margin = margins[:, number]
        if name == STICK:
            at, margin = table.grasp[0], grasp
        within = tuple(r for r, m in zip(names, margin.tolist(), strict=True) if m > 0)
        x, y = map(_metres, at.tolist())
        raised = table.top[0, number] - traits.height_m[number] > _RAISED_M
        state = _put_on(name, policy_input) if raised else ""
        found.append(ObjectText(name, x, y, within, state))
    return found


def _put_on(name: str, policy_input: PolicyInput) -> str:
    """Return the support of an object that is too high to lie on the table."""
    for step in reversed(policy_input.past):
        subtask = step.subtask
        if step.outcome == "success" and subtask.pick == name:
            if subtask.primitive is Primitive.MOVE and subtask.place != SHARED:
                return f"on the {subtask.place}"
            break
    return "on something"


def _metres(value: float) -> float:
    """Return a length in whole centimetres [m]."""
    return round(value, 2)
