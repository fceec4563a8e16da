"""What ReachNet's eye sees of a table, for planners that read."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from lemma.core.robot_names import robot_names
from lemma.policies.interfaces import PolicyInput
from lemma.policies.planners.scene_text import ObjectText, RobotText, SceneText
from lemma.scene.objects.entity import SHARED, STICK
from lemma.tasks.subtask import Primitive

if TYPE_CHECKING:
    from lemma.policies.models.reachnet.model import ReachNet
    from lemma.policies.models.reachnet.scene_table import SceneTable

WEIGHTS = "reachnet"
"""Whose eye it is, and whose estimate of what each robot reaches."""
_RAISED_M = 0.01


class SeenPerception:
    """Sees what is visible now; what is hidden is where it was seen at first."""

    weights = (WEIGHTS,)
    """Published weights that it uses."""

    def __init__(self, model: "ReachNet | None" = None) -> None:
        """Wait; weights are loaded when something shall be seen.

        Args:
            model: Whose eye; that of the published weights if None.
        """
        self._given = model

    @cached_property
    def model(self) -> "ReachNet":
        """Whose eye it is."""
        if self._given is not None:
            return self._given
        # torch is an extra, which other planners do without.
        from lemma.policies.models.reachnet.model import ReachNet  # noqa: PLC0415
        from lemma.policies.weights import load_model  # noqa: PLC0415

        model = load_model(WEIGHTS)
        assert isinstance(model, ReachNet)
        return model

    def look(self, inputs: Sequence[PolicyInput]) -> list[SceneText]:
        """Return the table of each episode."""
        return [self._look(given) for given in inputs]

    def _look(self, given: PolicyInput) -> SceneText:
        now = self._table(given)
        names = robot_names(len(given.robots))
        robots = []
        for number, (name, phrase) in enumerate(zip(names, given.robots, strict=True)):
            x, y = map(_metres, now.bases[0, number].tolist())
            inner, outer, _ = map(_metres, now.rings[0, number].tolist())
            robots.append(RobotText(name, phrase, x, y, (inner, outer)))
        objects = _objects(now, names, given)
        if given.past:
            seen = {thing.name for thing in objects}
            first = replace(given, view=given.past[0].view, past=())
            objects += [
                replace(thing, state="hidden now; it was there at first")
                for thing in _objects(self._table(first), names, first)
                if thing.name not in seen
            ]
        return SceneText(tuple(robots), tuple(objects))

    def _table(self, given: PolicyInput) -> "SceneTable":
        """Return what is seen in one view.

        The company of others in a batch would change last bits, and with them prompts.
        """
        from lemma.policies.batch import batch_of  # noqa: PLC0415

        model = self.model
        raster = model.config.raster(given)
        with model.deciding():
            batch = batch_of([given], raster, (), model.device, model.entities)
            marks, coarse = model.eye(batch)
            return model.eye.table(marks, coarse, batch)


def _objects(
    table: "SceneTable", names: tuple[str, ...], given: PolicyInput
) -> list[ObjectText]:
    """Return what is seen on one table."""
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
        state = _put_on(name, given) if raised else ""
        found.append(ObjectText(name, x, y, within, state))
    return found


def _put_on(name: str, given: PolicyInput) -> str:
    """Return what something lies on that is too high to lie on the table."""
    for step in reversed(given.past):
        subtask = step.subtask
        if step.outcome == "success" and subtask.pick == name:
            if subtask.primitive is Primitive.MOVE and subtask.place != SHARED:
                return f"on the {subtask.place}"
            break
    return "on something"


def _metres(value: float) -> float:
    """Return a length in whole centimetres [m]: no more is told of it."""
    return round(value, 2)
